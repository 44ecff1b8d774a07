"""The depth of an OpenEXR file is read, whatever else it holds; where it cannot be told, the channels are listed."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.stored import read_depth, read_exr

OpenEXR = pytest.importorskip("OpenEXR")

HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
DEPTH = np.array([[0.5, 2, 80], [0, 1, 300.25]], np.float32)


def write(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    OpenEXR.File({**HEADER, **header}, channels).write(str(path))
    return path


def others(*names: str) -> dict[str, np.ndarray]:
    """Channels that are not depth, each with values of its own."""
    return {name: np.full_like(DEPTH, 1 + number) for number, name in enumerate(names)}


def test_depth_is_read_in_either_precision(tmp_path: Path) -> None:
    for dtype in (np.float16, np.float32):
        found = read_depth(write(tmp_path / "a.exr", {"Z": DEPTH.astype(dtype)}))
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, DEPTH.astype(dtype))


def test_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no file .*a\.exr"):
        read_exr(tmp_path / "a.exr")
    (tmp_path / "a.exr").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"a\.exr is not a readable OpenEXR file"):
        read_exr(tmp_path / "a.exr")


def test_channels_count_together(tmp_path: Path) -> None:
    zeros = np.zeros((3000, 3000), np.float32)  # 36 MB each, in a few kilobytes
    assert read_exr(write(tmp_path / "one.exr", {"Z": zeros})).shape == zeros.shape
    with pytest.raises(InputError, match=r"many\.exr.*would unpack to"):
        read_exr(write(tmp_path / "many.exr", dict.fromkeys("ZRGB", zeros)))


@pytest.mark.parametrize("name", ["Y", "R", "A", "V", "Depth", "camera.R"])
def test_the_only_channel_is_depth_whatever_its_name(tmp_path: Path, name: str) -> None:
    np.testing.assert_array_equal(read_exr(write(tmp_path / "a.exr", {name: DEPTH})), DEPTH)


@pytest.mark.parametrize(
    ("name", "beside"),
    [
        ("Z", ("R", "G", "B", "A")),
        ("ViewLayer.Depth.Z", tuple(f"ViewLayer.Combined.{part}" for part in "RGBA")),
        ("ViewLayer.Depth.V", ("ViewLayer.Mist.V", "ViewLayer.IndexOB.V", "ViewLayer.Combined.A")),
        ("View Layer.depth.z", ("View Layer.Normal.X", "View Layer.Normal.Y", "View Layer.Normal.Z")),
        ("ViewLayer.Depth.Z", ("ViewLayer.Mist.Z", "ViewLayer.UV.U", "ViewLayer.UV.V")),
        ("beauty.depth", ("beauty.R", "beauty.G", "beauty.B")),
        ("left.Z", ("left.R", "left.G", "left.B", "ZBack")),
        ("ViewLayer.Depth.Z", ("ViewLayer.Denoising Depth.Z", "ViewLayer.Combined.R")),
        ("Display.Depth.Z", ("Display.Combined.R",)),
    ],
)
def test_depth_among_other_layers(tmp_path: Path, name: str, beside: tuple[str, ...]) -> None:
    np.testing.assert_array_equal(read_exr(write(tmp_path / "a.exr", {**others(*beside), name: DEPTH})), DEPTH)


def test_depth_in_a_part_of_its_own(tmp_path: Path) -> None:
    parts = [OpenEXR.Part({**HEADER, "name": "ViewLayer.Combined"}, others("R", "G", "B")),
             OpenEXR.Part({**HEADER, "name": "ViewLayer.Depth"}, {"Z": DEPTH})]  # fmt: skip
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), DEPTH)


def test_grey_in_three_channels_is_one_map(tmp_path: Path) -> None:
    opaque = {"A": np.ones_like(DEPTH)}
    np.testing.assert_array_equal(read_exr(write(tmp_path / "a.exr", dict.fromkeys("RGB", DEPTH) | opaque)), DEPTH)


@pytest.mark.parametrize(
    "names",
    [
        ("R", "G", "B"),
        ("R", "G", "B", "A"),
        ("Y", "RY", "BY"),
        ("Normal.X", "Normal.Y", "Normal.Z"),
        ("X", "Y", "Z"),
        ("H", "S", "V"),
        ("ViewLayer.Mist.Z", "ViewLayer.Combined.R"),
        ("ViewLayer.Mist.Z",),
        ("ViewLayer.IndexOB.X",),
        ("disparity.R",),
        ("InverseDepth.Z",),
        ("V.Normal.Z",),
        ("AO.V",),
        ("Albedo.V",),
        ("confidence.V",),
        ("ViewLayer.roughness.V", "ViewLayer.Combined.R", "ViewLayer.Combined.A"),
        ("left.Depth.Z", "right.Depth.Z"),
        ("FinalImage.R", "FinalImage.A", "FinalImageMovieRenderQueue_WorldDepth.R"),
    ],
    ids=" ".join,
)
def test_channels_are_listed_where_depth_cannot_be_told(tmp_path: Path, names: tuple[str, ...]) -> None:
    path = write(tmp_path / "a.exr", others(*names))
    with pytest.raises(InputError, match=r"a\.exr.*cannot be told: .*Save depth alone") as raised:
        read_exr(path)
    assert all(name in str(raised.value) for name in names)


def test_unreals_depth_beside_nothing_else_may_be_centimetres(tmp_path: Path) -> None:
    names = [f"FinalImageMovieRenderQueue_WorldDepth.{part}" for part in "RGB"]
    with pytest.raises(InputError, match="cannot be told"):
        read_exr(write(tmp_path / "a.exr", dict.fromkeys(names, DEPTH)))


@pytest.mark.parametrize("name", ["FinalImageMovieRenderQueue_WorldDepth.R", "SceneDepthWorldUnits.R"])
def test_unreals_depth_is_not_taken_for_metres(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"Unreal's depth, in centimetres: divide it by 100"):
        read_exr(write(tmp_path / "a.exr", {name: DEPTH}))


def test_whole_numbers_stay_whole_so_that_their_unit_is_asked_for(tmp_path: Path) -> None:
    levels = (100 * DEPTH).astype(np.uint32)
    found = read_exr(write(tmp_path / "a.exr", {"Z": levels}))
    np.testing.assert_array_equal(found, levels)
    assert found.dtype == np.uint32
    with pytest.raises(InputError, match="does not say its scale"):
        read_depth(tmp_path / "a.exr")
    np.testing.assert_allclose(read_depth(tmp_path / "a.exr", scale=100), levels / 100, rtol=1e-6)


def test_many_channels_are_not_all_listed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Crypto00\.R, .*Crypto11\.R and 28 more\. Save"):
        read_exr(write(tmp_path / "a.exr", others(*(f"Crypto{number:02}.R" for number in range(40)))))


def test_a_part_of_the_picture_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", {"Z": DEPTH}, dataWindow=((1, 1), (3, 2)), displayWindow=((0, 0), (9, 7)))
    with pytest.raises(
        InputError, match=r"a\.exr.*cover \(1, 1\) to \(3, 2\), and the picture is \(0, 0\) to \(9, 7\)"
    ):
        read_exr(path)


def test_half_floats_that_overflow_are_unknown(tmp_path: Path) -> None:
    far = DEPTH.astype(np.float16)
    far[0, 2] = np.inf  # a sky at 100 km
    found = read_depth(write(tmp_path / "a.exr", {"Z": far}))
    np.testing.assert_array_equal(found, np.where(np.isfinite(far), far, 0))


@pytest.mark.parametrize("name", ["disparity", "mist", "Normal", "confidence", "IndexOB"])
def test_a_lone_channel_of_something_else_is_no_depth(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"which of its channels is depth cannot be told: {name}"):
        read_depth(write(tmp_path / "a.exr", {name: DEPTH}))


def test_unreals_depth_is_refused_beside_an_alpha_too(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="SceneDepth is Unreal's depth, in centimetres"):
        read_depth(write(tmp_path / "a.exr", {"SceneDepth": DEPTH, "A": np.ones_like(DEPTH)}))
