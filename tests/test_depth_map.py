"""What a depth map says of itself, what can be measured in it, and the files it writes."""

import dataclasses
import math
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.calibration import Distance, Point, read_calibration, write_calibration
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, InputWarning
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.lens import Lens
from zoedepth.stored import read_depth


def depth_map(*, std: float | None = 0.1) -> DepthMap:
    """A slope from 1 m to 5 m; its standard deviation is the given share of the depth."""
    depth = np.linspace(1, 5, 40 * 60, dtype=np.float32).reshape(40, 60)
    photo = np.full((40, 60, 3), 90, np.uint8)
    spread = None if std is None else (std * depth).astype(np.float32)
    return DepthMap(depth, spread, "indoor", {"indoor": 1.0}, photo, (64, 96), Lens(fov_x=60).camera((40, 60)))


def test_size_and_confidence() -> None:
    result = depth_map()
    assert result.size == (40, 60)
    np.testing.assert_allclose(result.confidence, 1 / 1.1, rtol=1e-6)
    assert depth_map(std=None).confidence is None


def test_prints_in_a_line() -> None:
    expected = "DepthMap(60 x 40 pixels, 1.00 to 5.00 m, median 3.00 m, indoor, camera given: 60.0 degrees across)"
    assert repr(depth_map()) == expected


CAMERA = Camera((40, 60), 50.0, 52.0, 28.0, 21.5)


def wall(metres: float = 2.0, **fields: object) -> DepthMap:
    """A wall across the line of sight, with a standard deviation of a tenth, by a camera that looks past the middle."""
    return dataclasses.replace(
        depth_map(),
        depth=np.full((40, 60), metres, np.float32),
        std=np.full((40, 60), metres / 10, np.float32),
        camera=CAMERA,
        **fields,
    )


class TestMeasure:
    def test_depth_and_its_spread_are_those_of_the_nearest_pixel(self) -> None:
        result = depth_map()
        for x, y, pixel in ((7, 3, (3, 7)), (7.4, 2.6, (3, 7)), (-0.5, -0.5, (0, 0)), (59.49, 39.49, (39, 59))):
            found = result.at(x, y)
            assert found == (result.depth[pixel], result.std[pixel])
            assert found.depth == found[0]
        assert depth_map(std=None).at(7, 3).std is None

    def test_two_points_on_a_wall(self) -> None:
        """Thirty pixels across and forty down at 2 m, worked out by hand; the diagonal by Pythagoras."""
        assert wall().measure((10, 5), (40, 5)) == pytest.approx(2 * 30 / 50)
        assert wall().measure((10, 5), (10, 31)) == pytest.approx(2 * 26 / 52)
        assert wall().measure((10, 5), (40, 31)) == pytest.approx(math.hypot(1.2, 1.0))
        assert wall().measure((10.25, 5), (10.75, 5)) == pytest.approx(2 * 0.5 / 50), "fractions of pixels count"
        assert wall().measure((10, 5), (10, 5)) == 0

    def test_two_points_one_behind_the_other(self) -> None:
        result = wall()
        result.depth[:, 30:] = 5
        expected = np.array([5 * (40 - 28) / 50, 5 * (20 - 21.5) / 52, 5]) - [
            2 * (10 - 28) / 50,
            2 * (8 - 21.5) / 52,
            2,
        ]
        assert result.measure((10, 8), (40, 20)) == pytest.approx(np.linalg.norm(expected))

    def test_the_distance_is_the_length_of_the_ray(self) -> None:
        result = wall()
        np.testing.assert_allclose(result.distance, np.linalg.norm(result.points, axis=-1), rtol=1e-6)
        assert result.distance.dtype == np.float32
        assert result.distance[0, 0] == pytest.approx(2 * math.sqrt(1 + (28 / 50) ** 2 + (21.5 / 52) ** 2))
        assert result.distance is result.distance

    def test_points_are_what_the_camera_sees(self) -> None:
        result = depth_map()
        y, x = np.mgrid[:40, :60]
        np.testing.assert_allclose(result.camera.project(result.points), np.stack([x, y], axis=-1), atol=1e-3)
        np.testing.assert_array_equal(result.points[..., 2], result.depth)
        assert (result.intrinsics == result.camera.matrix).all()

    @pytest.mark.parametrize("place", [(-0.6, 3), (60, 3), (59.5, 3), (7, 39.5), (7, -1), (math.nan, 3), (7, math.inf)])
    def test_places_outside_of_the_photo_are_refused(self, place: tuple[float, float]) -> None:
        with pytest.raises(InputError, match=r"outside the photo of 60 x 40 pixels: x is the column, from 0 to 59"):
            wall().at(*place)
        with pytest.raises(InputError, match="outside the photo"):
            wall().measure((1, 1), place)

    def test_places_without_depth_to_rely_on_are_refused(self) -> None:
        result = wall(depth_range=(0.5, 3.0))
        for row, wrong in enumerate((0.5, 0.0, -1.0, 3.1, np.nan, np.inf)):
            result.depth[5 * row, 10] = wrong
        for row in range(6):
            assert not result.valid[5 * row, 10]
            with pytest.raises(InputError, match=f"x = 10, y = {5 * row}.*Take a pixel beside it"):
                result.at(10, 5 * row)
        assert result.valid[2, 40]

    def test_pixels_between_near_and_far_are_not_valid(self) -> None:
        """A border of a thing at 1 m before a wall at 2 m, three pixels wide, as networks leave it; a slope is fine."""
        result = wall()
        result.depth[:, :20] = 1
        result.depth[:, 20:23] = [1.25, 1.5, 1.75]
        assert not result.valid[:, 20:23].any()
        assert result.valid[:, :18].all()
        assert result.valid[:, 25:].all()
        assert depth_map().valid.mean() > 0.99


class TestCalibrate:
    def test_metres_are_put_right_and_the_rest_with_them(self) -> None:
        result = wall(depth_range=(0.1, 10.0))
        found = result.calibrate(np.full((40, 60), 2.5, np.float32))
        scale = found.calibration.scale
        assert scale == pytest.approx(1.25, rel=0.02)
        np.testing.assert_allclose(found.depth, 2 * scale, rtol=1e-6)
        np.testing.assert_allclose(found.std, 0.2 * scale, rtol=1e-6)
        assert found.depth_range == pytest.approx((0.1 * scale, 10 * scale), rel=1e-6)
        assert found.measure((10, 5), (40, 5)) == pytest.approx(2 * scale * 30 / 50, rel=1e-6)
        assert (found.calibration.camera, found.calibration.domain) == (CAMERA, "indoor")
        assert result.calibration is None
        assert result.depth.max() == 2

    def test_a_tape_measure_goes_along_the_ray(self) -> None:
        result = wall()
        along_ray = result.calibrate([(0, 0, 1.5 * float(result.distance[0, 0]))], along_ray=True)
        along_axis = result.calibrate([(0, 0, 1.5 * 2)])
        assert along_ray.calibration.scale == pytest.approx(along_axis.calibration.scale, rel=1e-6)
        assert 1.1 < along_axis.calibration.scale < 1.501

    @pytest.mark.parametrize(
        ("reading", "along_ray", "named"),
        [
            ((10, 5, 3.0), True, "a reading along the ray"),
            (((10, 5), (40, 5), 2.0), False, "the distance of two points"),
        ],
    )
    def test_what_goes_through_the_camera_needs_a_known_one(
        self, reading: Point | Distance, along_ray: bool, named: str
    ) -> None:
        known = wall()
        assumed = dataclasses.replace(known, camera=dataclasses.replace(CAMERA, source="assumed"))
        with pytest.raises(
            InputError, match=rf"^{named} needs the camera of the photo, .*--fov-x.*along the optical axis"
        ):
            assumed.calibrate([reading], along_ray=along_ray)
        assert assumed.calibrate([(10, 5, 3.0)]).calibration is not None
        assert known.calibrate([reading], along_ray=along_ray).calibration is not None

    def test_it_holds_for_other_photos_of_the_camera(self, tmp_path: Path) -> None:
        write_calibration(tmp_path / "camera.json", wall().calibrate([(10, 5, 3.0)]).calibration)
        calibration = read_calibration(tmp_path / "camera.json")
        other = dataclasses.replace(depth_map(std=None), camera=CAMERA)
        np.testing.assert_allclose(other.calibrated(calibration).depth, calibration.scale * other.depth, rtol=1e-6)
        assert other.calibrated(calibration).std is None
        with pytest.raises(InputError, match=r"does not hold for this photo: .*outdoor"):
            dataclasses.replace(wall(), domain="outdoor").calibrated(calibration)
        with pytest.raises(InputError, match="degrees from corner to corner"):
            dataclasses.replace(wall(), camera=Lens(fov_x=90).camera((40, 60))).calibrated(calibration)
        with pytest.raises(InputError, match="without the correction by the focal length"):
            wall(focal_correction=1.3).calibrated(calibration)

    def test_twice_is_refused(self) -> None:
        found = wall().calibrate([(10, 5, 3.0)])
        for again in (lambda: found.calibrate([(10, 5, 3.0)]), lambda: found.calibrated(found.calibration)):
            with pytest.raises(InputError, match="calibrated already"):
                again()

    @pytest.mark.parametrize(
        ("reading", "message"),
        [
            ((60, 5, 2.0), "lies outside of the photo, which has columns 0 to 59 and rows 0 to 39"),
            ((10, -1, 2.0), "lies outside of the photo"),
            ((10, 5, 0.0), "must be above 0 and finite, in metres"),
            ((10, 5, math.nan), "must be above 0 and finite, in metres"),
            ((20, 5, 2.0), "is at a pixel without valid depth"),
        ],
    )
    def test_readings_that_tell_nothing_are_refused(self, reading: tuple[float, float, float], message: str) -> None:
        """The last one lies at a pixel without depth."""
        result = wall()
        result.depth[5, 20] = np.nan
        with pytest.raises(InputError, match=message):
            result.calibrate([reading])


def test_points_normals_and_mesh_are_those_of_the_surface() -> None:
    result = wall()
    result.depth[5, 20] = np.nan
    np.testing.assert_allclose(result.points[0, 0], CAMERA.ray(0, 0) * 2, rtol=1e-6)
    assert np.isnan(result.normals[5, 20]).all()
    np.testing.assert_allclose(result.normals[result.valid], np.tile([0, 0, -1], (40 * 60 - 1, 1)), atol=1e-6)
    mesh = result.mesh()
    assert len(mesh.faces) == 2 * 39 * 59 - 4
    np.testing.assert_allclose(mesh.vertices, result.points[result.valid], rtol=1e-6)
    pytest.importorskip("fast_simplification")
    assert len(result.mesh(max_triangles=300).faces) <= 300


def test_save_writes_in_the_format_of_the_suffix(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    result = depth_map()
    result.save(tmp_path / "depth.png")
    np.testing.assert_allclose(read_depth(tmp_path / "depth.png"), result.depth, atol=5.1e-4)
    result.save(tmp_path / "kitti.png", scale=256.0)
    np.testing.assert_allclose(read_depth(tmp_path / "kitti.png", scale=256.0), result.depth, atol=2e-3)
    for name in ("depth.npy", "depth.npz"):
        result.save(tmp_path / name)
        np.testing.assert_array_equal(read_depth(tmp_path / name), result.depth)
    with np.load(tmp_path / "depth.npz") as arrays:
        np.testing.assert_array_equal(arrays["std"], result.std)
        np.testing.assert_array_equal(arrays["confidence"], result.confidence)
    for limit in (None, 50):
        result.save(tmp_path / "depth.glb", max_triangles=limit)
        (mesh,) = trimesh.load(tmp_path / "depth.glb").geometry.values()
        assert len(mesh.faces) == 2 * 39 * 59 if limit is None else 10 < len(mesh.faces) <= limit
    result.save(tmp_path / "depth.jpg")
    with Image.open(tmp_path / "depth.jpg") as picture:
        assert picture.size == result.preview().shape[1::-1]
    with pytest.raises(InputError, match=r"depth\.txt"):
        result.save(tmp_path / "depth.txt")


def test_another_scale_than_millimetres_is_told_unless_it_was_asked_for(tmp_path: Path) -> None:
    far = depth_map()
    far.depth[0, 0] = 70.0
    with pytest.warns(InputWarning, match=r"far\.png: beyond 65\.535 m: the PNG has 256 levels per metre"):
        far.save(tmp_path / "far.png")
    with pytest.warns(InputWarning, match=r"far\.png: clipped: too far for the scale"):
        far.save(tmp_path / "far.png", scale=1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        far.save(tmp_path / "far.png", scale=256)
        far.save(tmp_path / "far.exr" if find_spec("OpenEXR") else tmp_path / "far.npy")


def test_a_map_without_std_saves_depth_alone(tmp_path: Path) -> None:
    depth_map(std=None).save(tmp_path / "depth.npz")
    with np.load(tmp_path / "depth.npz") as arrays:
        assert "depth" in arrays
        assert not {"std", "confidence"} & set(arrays)
