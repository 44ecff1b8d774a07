"""Rules for every kind of file. A new kind is in ``OUTPUTS`` and inherits these tests."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.images import read_image
from zoedepth.outputs import OUTPUTS, Maps, Options, Output, output_names, write_maps

RAMP = np.linspace(1, 5, 12, dtype=np.float32).reshape(3, 4)
IMAGE = np.full((3, 4, 3), 200, np.uint8)
ALL = {"depth": RAMP, "relative": 1 / RAMP}
CAMERA = Camera.from_focal(4.0, (3, 4))
NO_OPENEXR = pytest.mark.skipif(find_spec("OpenEXR") is None, reason="OpenEXR is not installed")
EVERY = pytest.mark.parametrize(
    "output",
    [pytest.param(output, id=name, marks=NO_OPENEXR if name == "exr" else ()) for name, output in OUTPUTS.items()],
)


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@EVERY
class TestEveryOutput:
    def test_writes_one_file_of_each_map_it_can_be_made_of(self, output: Output, tmp_path: Path) -> None:
        for name in output.maps:
            path = tmp_path / name / f"photo{output.ending}"
            output.write(path, Maps(**{name: ALL[name]}, image=IMAGE, camera=CAMERA), Options())
            assert files(path.parent) == [path.name]
            assert path.stat().st_size > 0

    def test_refuses_what_it_cannot_be_made_of_and_leaves_nothing(self, output: Output, tmp_path: Path) -> None:
        for name in ALL.keys() - set(output.maps) | {None}:
            maps = Maps(**({name: ALL[name]} if name else {}), image=IMAGE, camera=CAMERA)
            with pytest.raises(InputError, match=rf"needs '({'|'.join(output.maps)})'|there is no map to write to"):
                output.write(tmp_path / f"photo{output.ending}", maps, Options())
        assert files(tmp_path) == []

    def test_has_an_ending_and_suffixes_of_its_own(self, output: Output) -> None:
        assert Path(f"photo{output.ending}").suffix
        assert output.summary
        others = [other for other in OUTPUTS.values() if other is not output]
        assert not any(other.ending.endswith(output.ending) for other in others)
        assert not set(output.suffixes) & {suffix for other in others for suffix in other.suffixes}
        assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in output.suffixes)


def test_the_suffix_chooses_the_output(tmp_path: Path) -> None:
    maps = Maps(depth=RAMP, image=IMAGE, camera=CAMERA)
    for name, output in OUTPUTS.items():
        if name == "exr" and find_spec("OpenEXR") is None:
            continue
        for suffix in output.suffixes:
            output.write(tmp_path / f"expected{suffix}", maps, Options())
            write_maps(tmp_path / f"found{suffix.upper()}", maps)
            found, expected = tmp_path / f"found{suffix.upper()}", tmp_path / f"expected{suffix}"
            assert found.read_bytes() == expected.read_bytes()
    with pytest.raises(InputError, match=r"depth\.txt.*\.png, .*\.glb"):
        write_maps(tmp_path / "depth.txt", maps)


def test_maps_must_fit_together() -> None:
    for wrong in ({"depth": RAMP[None]}, {"depth": np.zeros((0, 4), np.float32)}, {"std": IMAGE}):
        with pytest.raises((InputError, TypeError), match=r"height, width|std"):  # TypeError: types checked at run time
            Maps(**wrong)
    with pytest.raises(InputError, match="one size"):
        Maps(depth=RAMP, image=IMAGE[:2])
    with pytest.raises(InputError, match="one size"):
        Maps(depth=RAMP, camera=CAMERA.resized((6, 8)))


def test_depth_is_valid_where_it_is_finite_and_in_its_range() -> None:
    depth = RAMP.copy()
    depth[0, :3] = np.nan, np.inf, -1
    np.testing.assert_array_equal(Maps(depth=depth).valid, [[0, 0, 0, 1], [1] * 4, [1] * 4])
    in_range = Maps(depth=RAMP, depth_range=(float(RAMP[0, 1]), float(RAMP[2, 2]))).valid
    np.testing.assert_array_equal(in_range, [[0, 0, 1, 1], [1] * 4, [1, 1, 1, 0]])
    assert Maps(relative=RAMP).valid is None


def test_what_is_too_far_makes_no_points_and_keeps_its_depth(tmp_path: Path) -> None:
    end = float(RAMP[1, 1])
    maps = Maps(depth=RAMP, image=IMAGE, camera=CAMERA)
    assert maps.up_to(None) is maps
    np.testing.assert_array_equal(maps.up_to(end).valid, maps.valid & (end >= RAMP))
    assert maps.up_to(1e9).depth_range == (0.0, 1e9)
    assert Maps(depth=RAMP, depth_range=(0.1, 2.0)).up_to(1e9).depth_range == (0.1, 2.0)
    write_maps(tmp_path / "all.npz", maps, Options(max_depth=end))
    with np.load(tmp_path / "all.npz") as arrays:
        np.testing.assert_array_equal(arrays["depth"], RAMP)
        np.testing.assert_array_equal(arrays["valid"], maps.valid & (end >= RAMP))
    for wrong in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match=r"above 0 m \(--max-depth, max_depth=\), got"):
            Options(max_depth=wrong)


def test_panoramas_become_points_and_a_surface_all_around(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    distance = np.full((20, 40), 2, np.float32)
    maps = Maps(depth=distance, image=np.full((20, 40, 3), 90, np.uint8), panorama=True)
    for name in ("ball.ply", "ball.glb"):
        write_maps(tmp_path / name, maps)
        found = trimesh.load(tmp_path / name)
        np.testing.assert_allclose(found.bounds, [[-2] * 3, [2] * 3], atol=0.03)
    write_maps(tmp_path / "ball.npz", maps)
    with np.load(tmp_path / "ball.npz") as arrays:
        assert arrays["projection"] == "equirectangular"
        assert arrays["valid"].all()
    with pytest.raises(InputError, match="no camera"):
        Maps(depth=RAMP, camera=CAMERA, panorama=True)


def test_confidence_is_that_of_the_standard_deviation() -> None:
    np.testing.assert_allclose(Maps(depth=RAMP, std=RAMP).confidence, 0.5)
    assert Maps(depth=RAMP).confidence is None


@pytest.mark.parametrize(
    ("words", "map", "names"),
    [
        (["depth", "preview"], "depth", ("depth", "preview")),
        (["png,exr, glb"], "depth", ("depth", "exr", "glb")),
        (["depth,npy", "npy", ".PNG"], "depth", ("depth", "npy")),
        (["tif", "jpg", "webp"], "depth", ("tiff", "preview")),
        (["png", "color", "npz"], "relative", ("relative", "color", "npz")),
        ([], "depth", ()),
    ],
)
def test_outputs_are_named_by_word_or_suffix_with_or_without_commas(
    words: list[str], map: str, names: tuple[str, ...]
) -> None:
    assert output_names(words, map=map) == names


def test_output_that_does_not_exist_is_told_with_those_that_do() -> None:
    with pytest.raises(InputError, match="no output 'previeww': did you mean preview"):
        output_names(["depth,previeww"])


@EVERY
def test_notes_of_the_photo_go_into_no_file(output: Output, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x010E] = "SECRET"  # description of the picture
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 12.0, 30.0), 29: "2001:02:03"})  # GPS
    Image.fromarray(IMAGE).save(tmp_path / "photo.jpg", exif=exif)
    assert b"SECRET" in (tmp_path / "photo.jpg").read_bytes()
    maps = {name: ALL[name] for name in output.maps}
    output.write(
        tmp_path / f"a{output.ending}", Maps(**maps, image=read_image(tmp_path / "photo.jpg"), camera=CAMERA), Options()
    )
    content = (tmp_path / f"a{output.ending}").read_bytes()
    assert not [note for note in (b"SECRET", b"2001:02:03") if note in content]


@pytest.mark.parametrize(
    "options",
    [{"max_triangles": 0}, {"png_scale": 0.0}, {"png_scale": np.nan}, {"vmin": 5.0, "vmax": 1.0}, {"colormap": "jet"}],
)
def test_wrong_options_are_found_before_anything_is_written(options: dict) -> None:
    with pytest.raises(InputError, match=r"scale|vmin|jet|triangle"):
        Options(**options)
