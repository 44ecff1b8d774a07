"""Files of cameras: what other programs write is read to the last bit, and everything else is refused with a reason."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.camera_files import read_camera, read_cameras
from zoedepth.geometry.lens import camera_of

SIZE = (480, 640)
# Numbers with many digits, so that a lost one shows.
FX, FY, CX, CY = 518.8579014285714, 519.4696111111113, 325.58244941119034, 253.73616633400465
CAMERA = Camera(SIZE, FX, FY, CX, CY)
MATRIX = CAMERA.matrix

OPENCV = f"""%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024 10:00:00"
nframes: 20
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {FX}, 0., {CX}, 0.,
       {FY}, {CY}, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
avg_reprojection_error: 2.5e-01
"""
ROS = f"""image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [{FX}, 0, {CX}, 0, {FY}, {CY}, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [{FX}, 0, {CX}, 0, 0, {FY}, {CY}, 0, 0, 0, 1, 0]
"""
ROS_TOPIC = f"""header:
  seq: 5
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [{FX}, 0.0, {CX}, 0.0, {FY}, {CY}, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [{FX}, 0.0, {CX}, 0.0, 0.0, {FY}, {CY}, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
---
"""
KALIBR = f"""cam0:
  camera_model: pinhole
  intrinsics: [{FX}, {FY}, {CX}, {CY}]
  distortion_model: radtan
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""
COLMAP = f"""# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 1
1 PINHOLE 640 480 {FX} {FY} {CX} {CY}
"""
OWN = {"zoedepth": "0.1", "source": "photo.jpg", "camera": asdict(CAMERA), "files": {}}
NERF = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": 640, "h": 480, "k1": 0, "camera_model": "OPENCV", "frames": []}
REALSENSE = {"width": 640, "height": 480, "ppx": CX, "ppy": CY, "fx": FX, "fy": FY, "coeffs": [0, 0, 0, 0, 0]}
OPEN3D = {"width": 640, "height": 480, "intrinsic_matrix": [FX, 0, 0, 0, FY, 0, CX, CY, 1]}
OPENCV_JSON = {"mtx": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": MATRIX.ravel().tolist()}}


def write(path: Path, content: object) -> Path:
    """Write a text, JSON, or an array."""
    if isinstance(content, np.ndarray):
        np.save(path, content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def error(path: Path, content: object, size: tuple[int, int] = SIZE) -> str:
    """Return why a file is refused; the file is named once."""
    with pytest.raises(InputError) as caught:
        read_camera(write(path, content), size)
    assert str(caught.value).count(str(path)) == 1
    return str(caught.value)


def numbers(camera: Camera) -> tuple[float, float, float, float]:
    return camera.fx, camera.fy, camera.cx, camera.cy


SLAM = f'%YAML:1.0\nCamera.type: "PinHole"\nCamera1.fx: {FX}\nCamera1.fy: {FY}\nCamera1.cx: {CX}\nCamera1.cy: {CY}\n'


def test_orb_slams_keys_and_matrices_by_columns(tmp_path: Path) -> None:
    assert numbers(read_camera(write(tmp_path / "slam.yaml", SLAM), SIZE)) == (FX, FY, CX, CY)
    said = error(tmp_path / "k.npy", MATRIX.T)
    assert "It is written by columns: transpose it" in said


ROI = ROS_TOPIC.replace(
    "binning_x: 0\n",
    "binning_x: 0\nroi:\n  x_offset: 100\n  y_offset: 60\n  height: 240\n  width: 320\n  do_rectify: False\n",
)


def test_a_window_of_the_sensor_has_the_matrix_of_the_whole(tmp_path: Path) -> None:
    whole = ROI.replace("height: 240", "height: 0").replace("width: 320", "width: 0")
    assert numbers(read_camera(write(tmp_path / "whole.yaml", whole), SIZE)) == (FX, FY, CX, CY)
    found = read_camera(write(tmp_path / "roi.yaml", ROI), (240, 320))
    assert numbers(found) == (FX, FY, CX - 100, CY - 60)
    binned = read_camera(tmp_path / "roi.yaml", (120, 160))
    assert numbers(binned) == pytest.approx((FX / 2, FY / 2, (CX - 99.5) / 2 - 0.5, (CY - 59.5) / 2 - 0.5))
    assert "does not lie in its photos of 640 x 480" in error(
        tmp_path / "out.yaml", ROI.replace("x_offset: 100", "x_offset: 400"), (240, 320)
    )


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("opencv.yaml", OPENCV),
        ("opencv.YML", "\ufeff" + OPENCV),
        ("opencv.json", OPENCV_JSON),
        ("ros.yaml", ROS),
        ("topic.yaml", ROS_TOPIC),
        ("topic2.yaml", ROS_TOPIC.lower()),
        ("kalibr.yaml", KALIBR),
        ("realsense.json", REALSENSE),
        ("open3d.json", OPEN3D),
        ("own.json", OWN),
        ("alone.json", OWN["camera"]),
        ("calibration.json", {"zoedepth": "0.1", "calibration": {"scale": 1.5, "camera": OWN["camera"]}}),
        ("plain.json", {"fx": FX, "fy": FY, "cx": CX, "cy": CY}),
        ("plain.yaml", f"fx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n"),
        ("matrix.json", MATRIX.tolist()),
        ("flat.json", MATRIX.ravel().tolist()),
        ("k.json", {"K": MATRIX.tolist(), "image_size": [640, 480]}),
        ("matrix.txt", f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n"),
        ("commas.txt", f"# fx, fy, cx, cy\n{FX}, {FY}, {CX}, {CY}\n"),
        ("scannet.txt", f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n0 0 0 1\n"),
        ("matrix.npy", MATRIX),
    ],
)
def test_what_programs_write_is_read_to_the_last_bit(tmp_path: Path, name: str, content: object) -> None:
    assert read_camera(write(tmp_path / name, content), SIZE) == CAMERA


def test_what_numpy_and_opencv_write(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "matrix.txt", MATRIX, fmt="%.17g")
    assert read_camera(str(tmp_path / "matrix.txt"), SIZE) == CAMERA
    np.save(tmp_path / "matrix.npy", np.asfortranarray(MATRIX))
    assert read_camera(tmp_path / "matrix.npy", SIZE) == CAMERA
    np.save(tmp_path / "whole.npy", np.array([[500, 0, 320], [0, 500, 240], [0, 0, 1]]))
    assert numbers(read_camera(tmp_path / "whole.npy", SIZE)) == (500, 500, 320, 240)


class TestHalfAPixel:
    """COLMAP and NeRFs count from the corner of the first pixel: its centre is at (0.5, 0.5)."""

    @pytest.mark.parametrize(
        ("name", "content"), [("cameras.txt", COLMAP), ("transforms.json", NERF)], ids=["COLMAP", "NeRF"]
    )
    def test_is_taken_off(self, tmp_path: Path, name: str, content: object) -> None:
        assert numbers(read_camera(write(tmp_path / name, content), SIZE)) == (FX, FY, CX - 0.5, CY - 0.5)

    def test_the_middle_is_the_middle(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", "1 SIMPLE_PINHOLE 640 480 500 320 240")
        assert read_camera(path, SIZE) == Camera.from_focal(500, SIZE)
        assert read_camera(path, (240, 320)) == Camera.from_focal(250, (240, 320))
        angle = 2 * np.arctan(320 / 500)
        path = write(tmp_path / "transforms.json", {"camera_angle_x": angle, "w": 640, "h": 480})
        assert read_camera(path, SIZE).fx == pytest.approx(500)


class TestSize:
    def test_resized_photos(self, tmp_path: Path) -> None:
        path = write(tmp_path / "camera.yaml", ROS)
        assert read_camera(path, (240, 320)) == CAMERA.resized((240, 320))
        assert read_camera(path, (333, 444)) == CAMERA.resized((333, 444))
        assert read_camera(path, (100, 133)) == CAMERA.resized((100, 133)), "133.3, rounded"

    @pytest.mark.parametrize("size", [(480, 600), (640, 480), (360, 640)])
    def test_other_proportions(self, tmp_path: Path, size: tuple[int, int]) -> None:
        said = error(tmp_path / "camera.yaml", ROS, size)
        assert "640 x 480" in said
        assert f"{size[1]} x {size[0]}" in said

    def test_files_that_tell_none(self, tmp_path: Path) -> None:
        path = write(tmp_path / "matrix.npy", MATRIX)
        assert read_camera(path, (500, 700)) == Camera((500, 700), FX, FY, CX, CY)
        for height, width in ((240, 320), (3000, 4000)):
            said = error(tmp_path / "matrix.npy", MATRIX, (height, width))
            assert (
                f"the principal point, (325.582, 253.736), is far from the middle of a photo of {width} x {height}"
                in said
            )
        assert "width and height" in said
        crop = {"fx": FX, "fy": FY, "cx": -20, "cy": CY, "width": 640, "height": 480}
        assert read_camera(write(tmp_path / "crop.json", crop), SIZE).cx == -20, "a crop may lie beside its axis"

    def test_numbers_in_parts_of_the_sides(self, tmp_path: Path) -> None:
        normalized = {"fx": 0.81, "fy": 1.08, "cx": 0.5, "cy": 0.5}
        assert "multiply them and the principal point by its width and height" in error(tmp_path / "n.json", normalized)


@pytest.mark.parametrize("name", ["intrinsics", "camera_matrix", "K"])
def test_numbers_with_names_are_taken_by_these(tmp_path: Path, name: str) -> None:
    sorted_keys = {"cx": CX, "cy": CY, "fx": FX, "fy": FY}
    path = write(tmp_path / "a.json", {"width": 640, "height": 480, name: sorted_keys})
    assert read_camera(path, SIZE) == Camera(SIZE, FX, FY, CX, CY)
    curved = {"width": 640, "height": 480, name: sorted_keys | {"coeffs": [0.1, 0, 0, 0, 0]}}
    assert "has lens distortion (0.1" in error(tmp_path / "b.json", curved)


@pytest.mark.parametrize("name", ["distortion_params", "distortion_coefficients", "distortionParameters"])
def test_distortion_by_any_of_its_names_is_refused(tmp_path: Path, name: str) -> None:
    content = {"fl_x": 500, "fl_y": 500, "cx": 320, "cy": 240, "w": 640, "h": 480, name: [0.2, 0, 0, 0, 0, 0]}
    assert "has lens distortion (0.2" in error(tmp_path / "transforms.json", content)


def test_angle_of_a_nerf_leaves_its_principal_point(tmp_path: Path) -> None:
    content = {"camera_angle_x": 1.0, "w": 640, "h": 480, "cx": 280, "cy": 260}
    found = read_camera(write(tmp_path / "transforms.json", content), SIZE)
    assert (found.cx, found.cy) == (279.5, 259.5)


class TestSeveralCameras:
    FIRST, SECOND = "1 PINHOLE 640 480 500 510 320 240\n", "2 SIMPLE_PINHOLE 320 240 300 160 120\n"

    def test_the_size_decides(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", self.FIRST + self.SECOND)
        assert read_camera(path, SIZE) == Camera(SIZE, 500, 510, 319.5, 239.5)
        assert read_camera(path, (240, 320)) == Camera((240, 320), 300, 300, 159.5, 119.5)

    def test_all_of_them_serve_photos_of_several_sizes(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", self.FIRST + self.SECOND)
        cameras = read_cameras(path, SIZE)
        assert camera_of(cameras, SIZE) == read_camera(path, SIZE)
        assert camera_of(cameras, (240, 320)) == read_camera(path, (240, 320))
        with pytest.raises(
            InputError, match=r"of 2 cameras, for photos of 320 x 240, 640 x 480, none is for one of 64 x 48"
        ):
            camera_of(cameras, (48, 64))

    def test_equal_ones_are_one(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", self.FIRST + self.FIRST.replace("1 P", "7 P"))
        assert read_camera(path, (240, 320)).fx == 250

    def test_otherwise_somebody_has_to_choose(self, tmp_path: Path) -> None:
        path = tmp_path / "cameras.txt"
        said = error(path, self.FIRST + self.SECOND, (480, 720))
        assert "2 cameras, for photos of 640 x 480, 320 x 240, and nothing tells which" in said
        assert "leave only its line in a copy" in said
        other = self.FIRST.replace("1 P", "3 P").replace("500", "501")
        assert "nothing tells which" in error(path, self.FIRST + other)
        many = "".join(f"{i} SIMPLE_PINHOLE {i} 10 5 5 5\n" for i in range(1, 400))
        assert "5 x 10, 6 x 10, ..., and" in error(path, many)
        assert "several cameras" in error(tmp_path / "chain.yaml", KALIBR + KALIBR.replace("cam0", "cam1"))

    def test_distortion_of_others_does_not_matter(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", self.FIRST + "2 SIMPLE_RADIAL 320 240 300 160 120 0.1\n")
        assert read_camera(path, SIZE).fx == 500
        assert "lens distortion (0.1)" in error(path, path.read_text(), (240, 320))
        assert "cameras.txt" not in repr(
            read_cameras(path, SIZE)
        )  # by which a job knows its cameras, wherever they lie
        with pytest.raises(InputError, match=r"cameras\.txt: it has lens distortion \(0\.1\)"):
            camera_of(read_cameras(path, SIZE), (240, 320))

    def test_nonsense_of_others_is_told_to_their_photos(self, tmp_path: Path) -> None:
        path = write(tmp_path / "cameras.txt", self.FIRST + "2 SIMPLE_PINHOLE 320 240 0.9 0.5 0.5\n")
        cameras = read_cameras(path, SIZE)
        assert camera_of(cameras, SIZE).fx == 500
        with pytest.raises(InputError, match="which is nonsense"):
            camera_of(cameras, (240, 320))


class TestDistortion:
    @pytest.mark.parametrize(
        ("name", "content"),
        [
            ("a.yaml", OPENCV.replace("[ 0., 0., 0., 0., 0. ]", "[ -0.25, 0., 0., 0., 0. ]")),
            ("b.yaml", ROS.replace("[0, 0, 0, 0, 0]", "[-0.25, 0, 0, 0, 0]")),
            ("c.yaml", ROS_TOPIC.replace("D: [0.0,", "D: [-0.25,")),
            ("d.yaml", KALIBR.replace("coeffs: [0.0,", "coeffs: [-0.25,")),
            ("e.json", {**NERF, "k1": -0.25}),
            ("f.json", {**REALSENSE, "coeffs": [-0.25, 0, 0, 0, 0]}),
            ("g.txt", "1 SIMPLE_RADIAL 640 480 500 320 240 -0.25"),
            ("h.txt", "1 OPENCV 640 480 500 500 320 240 -0.25 0 0 0"),
            ("i.json", {"K": MATRIX.tolist(), "dist": [[-0.25], [0.0], [0.0], [0.0], [0.0]]}),
            ("j.json", {"K": MATRIX.tolist(), "distortion": {"k1": -0.25, "k2": 0}}),
        ],
    )
    def test_is_refused(self, tmp_path: Path, name: str, content: object) -> None:
        said = error(tmp_path / name, content)
        assert "it has lens distortion (-0.25" in said
        assert "undistort the photo first" in said

    @pytest.mark.parametrize(
        ("name", "content"),
        [
            ("a.yaml", ROS.replace("plumb_bob", "equidistant")),
            ("b.yaml", KALIBR.replace("radtan", "equidistant")),
            ("c.yaml", KALIBR.replace("pinhole", "omni")),
            ("d.json", {**NERF, "camera_model": "OPENCV_FISHEYE"}),
            ("e.txt", "1 OPENCV_FISHEYE 640 480 500 500 320 240 0 0 0 0"),
            ("f.txt", "1 FOV 640 480 500 500 320 240 0"),
        ],
    )
    def test_models_that_bend_lines_without_it(self, tmp_path: Path, name: str, content: object) -> None:
        assert "which is not that of a pinhole camera: undistort the photo first" in error(tmp_path / name, content)

    @pytest.mark.parametrize(
        "line", ["SIMPLE_RADIAL 640 480 500 320 240 0", "RADIAL 640 480 500 320 240 0 0",
                 "OPENCV 640 480 500 500 320 240 0 0 0 0", "FULL_OPENCV 640 480 500 500 320 240 0 0 0 0 0 0 0 0"],
    )  # fmt: skip
    def test_of_zero_is_none(self, tmp_path: Path, line: str) -> None:
        assert read_camera(write(tmp_path / "cameras.txt", "1 " + line), SIZE) == Camera.from_focal(500, SIZE)


class TestSource:
    def test_is_that_of_the_file(self, tmp_path: Path) -> None:
        told = {**OWN, "camera": {**OWN["camera"], "source": "exif"}}
        assert read_camera(write(tmp_path / "photo.json", told), SIZE).source == "exif"
        assert read_camera(write(tmp_path / "other.json", {**REALSENSE, "source": "D435"}), SIZE).source == "given"

    def test_assumed_cameras_are_no_knowledge(self, tmp_path: Path) -> None:
        assumed = {**OWN, "camera": {**OWN["camera"], "source": "assumed"}}
        assert "was only assumed" in error(tmp_path / "photo.json", assumed)


class TestRubbish:
    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("a.xml", "<opencv_storage>", "cv2.FileStorage"),
            ("cameras.bin", "", "colmap model_converter"),
            ("photo.jpg", "", "ends in one of .yaml, .yml, .json, .txt, .npy"),
            ("a.yaml", "- 1\n- 2\n", "has no keys"),
            ("a.yaml", "", "has no keys"),
            ("a.yaml", "a: [1, 2", "no YAML"),
            ("a.yaml", "a: &x [1]\nb: *x\n", "aliases"),
            ("a.yaml", "[" * 200 + "]" * 200, "nested deeper"),
            ("a.yaml", "[" * 100_000, "nested deeper"),
            ("a.yaml", "fx: .nan\nfy: 5\ncx: 1\ncy: 1\n", "something else where a number belongs"),
            ("a.yaml", "camera_matrix: !!python/object/apply:os.system ['echo']\n", "where a number belongs"),
            ("a.yaml", "x" * 200_000, "longer than 131,072 bytes"),
            ("a.json", "{", "not a JSON object"),
            ("a.json", {}, "it has no camera"),
            ("a.json", {"camera": {}}, "it has no camera"),
            ("a.json", {"calibration": {"camera": None}}, "it has no camera"),
            ("a.json", {"camera_angle_x": 1.0}, "it has no camera"),
            ("a.json", {"fx": 5}, "no principal point"),
            ("a.json", {"fx": "wide", "cx": 1, "cy": 1}, "where a number belongs"),
            ("a.json", {"fx": -5, "cx": 1, "cy": 1}, "focal length fx must be above 0"),
            ("a.json", {"fx": 0, "cx": 1, "cy": 1}, "focal length fx must be above 0"),
            ("a.json", '{"fx": NaN, "cx": 1, "cy": 1}', "NaN is not a number in JSON"),
            ("a.json", {**REALSENSE, "width": 0}, "would have 0 x 480 pixels"),
            ("a.json", {**REALSENSE, "width": 640.5}, "would have 640.5 x 480 pixels"),
            ("a.json", [[1, 2], [3]], "no camera matrix|numbers of shape"),
            ("a.json", {"K": [1, 2, 3]}, "a camera matrix has 3 x 3"),
            ("a.json", {"K": [[500, 1, 320], [0, 500, 240], [0, 0, 1]]}, "a camera matrix must be"),
            ("a.txt", "", "a camera matrix has 3 x 3"),
            ("a.txt", "1 2\n3\n", "no camera matrix"),
            ("a.txt", "500 nan 320\n0 500 240\n0 0 1\n", "a camera matrix must be"),
            ("a.txt", "what is it\n", "where a number belongs"),
            ("a.txt", "1 PINHOLE 640 480 500 500 320\n", "none of COLMAP's"),
            ("a.txt", "1 PINHOLE\n", "none of COLMAP's"),
            ("a.txt", "1 PINHOLE 640 480 500 500 320 240\n2\n", "none of COLMAP's"),
            ("a.txt", "1 PINHOLE 640 inf 500 500 320 240\n", "would have 640 x inf pixels"),
            ("a.txt", "1 PINHOLE 640 480 500 five 320 240\n", "where a number belongs"),
            ("a.npy", np.zeros((2, 3)), "a camera matrix has 3 x 3"),
            ("a.npy", np.full((3, 3), np.nan), "a camera matrix must be"),
        ],
    )  # fmt: skip
    def test_is_refused(self, tmp_path: Path, name: str, content: object, message: str) -> None:
        path = tmp_path / name
        with pytest.raises(InputError, match=message) as caught:
            read_camera(write(path, content), SIZE)
        assert str(path) in str(caught.value)
        if isinstance(content, np.ndarray):
            path.unlink(missing_ok=True)

    def test_missing_files(self, tmp_path: Path) -> None:
        for name in ("none.yaml", "none.json", "none.txt", "none.npy"):
            with pytest.raises(InputError, match=f"{name}.*(Check|check) the path"):
                read_camera(tmp_path / name, SIZE)

    @given(
        name=st.sampled_from(["f.yaml", "f.json", "f.txt"]),
        base=st.sampled_from(
            [OPENCV, ROS, KALIBR, COLMAP, json.dumps(OWN), json.dumps(NERF), json.dumps(MATRIX.tolist())]
        ),
        edits=st.lists(st.tuples(st.integers(0, 800), st.text(max_size=4)), max_size=6),
    )
    def test_edited_files(
        self, tmp_path_factory: pytest.TempPathFactory, name: str, base: str, edits: list[tuple[int, str]]
    ) -> None:
        """A file that somebody has broken gives a camera or an error that names it, and nothing else."""
        for place, text in edits:
            base = base[: place % len(base)] + text + base[place % len(base) + len(text) :]
        path = tmp_path_factory.getbasetemp() / name
        path.write_text(base, encoding="utf-8", errors="surrogatepass")
        try:
            size, message = read_camera(path, SIZE).size, ""
        except InputError as refused:
            size, message = None, str(refused)
        assert size == SIZE or str(path) in message
