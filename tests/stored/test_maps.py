"""Depth maps and masks are read back as written, in metres, and refused where a file is damaged or is no map."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import bombs

import zoedepth
from zoedepth.errors import InputError
from zoedepth.outputs.depth import write_depth_png
from zoedepth.outputs.relative import write_relative_png
from zoedepth.stored import (
    Memory,
    declared_scale,
    read_depth,
    read_mask,
    read_png,
    read_png_with_text,
    read_stored,
)

METRES = np.array([[0.5, 1.25, 0], [300.25, 2, 65.5]], np.float32)


def picture(path: Path, values: np.ndarray) -> Path:
    Image.fromarray(values).save(path)
    return path


def test_is_offered_by_the_package() -> None:
    assert zoedepth.read_depth is read_depth


@pytest.mark.parametrize(("dtype", "suffix"), [("f2", "npy"), ("f4", "npy"), (">f8", "npy"), ("f4", "npz")])
def test_arrays_are_metres(tmp_path: Path, dtype: str, suffix: str) -> None:
    path = tmp_path / f"depth.{suffix}"
    np.save(path, METRES.astype(dtype)) if suffix == "npy" else np.savez_compressed(path, depth=METRES, other=1)
    found = read_depth(path)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, METRES)
    np.testing.assert_allclose(read_depth(path, scale=1000), METRES / 1000, rtol=1e-6)


def test_floats_in_a_tiff_are_metres_where_nobody_says_their_scale(tmp_path: Path) -> None:
    path = picture(tmp_path / "depth.tiff", METRES * 1000)
    np.testing.assert_array_equal(read_depth(path), METRES * 1000)
    np.testing.assert_allclose(read_depth(path, scale=1000), METRES, rtol=1e-6)


def test_whole_numbers_need_a_scale_in_arrays_too(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.array([[500, 0, 65535]], np.uint16))
    np.testing.assert_allclose(read_depth(tmp_path / "depth.npy", scale=1000), [[0.5, 0, 65.535]], rtol=1e-6)
    with pytest.raises(InputError, match=r"depth\.npy does not say its scale: give the stored value of one metre"):
        read_depth(tmp_path / "depth.npy")
    np.save(tmp_path / "grey.npy", np.array([[50, 255]], np.uint8))
    with pytest.raises(InputError, match=r"grey\.npy is not a depth map: it has 8 bits a pixel"):
        read_depth(tmp_path / "grey.npy", scale=1000)


def test_levels_of_a_picture_are_divided_by_the_scale(tmp_path: Path) -> None:
    levels = np.array([[500, 0, 65535]], np.uint16)
    for name in ("depth.png", "depth.tif"):
        path = picture(tmp_path / name, levels)
        np.testing.assert_array_equal(read_depth(path, scale=1000), np.float32([[0.5, 0, 65.535]]))
        with pytest.raises(InputError, match=rf"{name} does not say its scale: give the stored value of one metre"):
            read_depth(path)


def test_png_of_this_package_says_its_scale(tmp_path: Path) -> None:
    write_depth_png(tmp_path / "depth.png", np.array([[80.0]]), scale=256)
    assert read_depth(str(tmp_path / "depth.png")) == 80
    assert read_depth(tmp_path / "depth.png", scale=512) == 40


@pytest.mark.parametrize("mode", ["L", "RGB", "P", "1"])
def test_picture_that_is_no_depth_is_an_error(tmp_path: Path, mode: str) -> None:
    Image.new(mode, (2, 2)).save(tmp_path / "photo.png")
    with pytest.raises(InputError, match=r"photo\.png is not a depth map") as raised:
        read_depth(tmp_path / "photo.png", scale=1000)
    assert ("packed into red, green and blue" in str(raised.value)) == (mode == "RGB")


@pytest.mark.parametrize("name", ["missing.png", "missing.npy", "missing.npz", "missing.tif", "missing.exr"])
def test_missing_file_is_an_error_that_names_it(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"there is no file .*{name}"):
        read_depth(tmp_path / name)


def test_other_suffix_is_an_error_that_lists_the_right_ones(tmp_path: Path) -> None:
    (tmp_path / "depth.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"depth\.jpg: use one of \.png, \.npy.* A \.jpg has 8 bits a pixel"):
        read_depth(tmp_path / "depth.jpg")
    (tmp_path / "depth.xyz").write_bytes(b"")
    with pytest.raises(InputError, match=r"depth\.xyz: use one of \.png.*shard\)$"):
        read_depth(tmp_path / "depth.xyz")


def test_rubbish_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    for suffix in (".png", ".npy", ".npz", ".tif"):
        (tmp_path / f"depth{suffix}").write_bytes(b"rubbish")
        with pytest.raises(InputError, match=rf"depth{suffix} is not a readable"):
            read_depth(tmp_path / f"depth{suffix}")


def test_declared_scale(tmp_path: Path) -> None:
    write_depth_png(tmp_path / "depth.png", np.array([[80.0]]), scale=256)
    assert declared_scale(tmp_path / "depth.png") == 256
    assert declared_scale(picture(tmp_path / "bare.png", np.ones((1, 1), np.uint16))) is None
    (tmp_path / "text.png").write_text("no picture")
    assert declared_scale(tmp_path / "text.png") is None
    assert declared_scale(tmp_path / "missing.png") is None


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "mm", ""])
def test_scale_that_is_none_is_not_declared(tmp_path: Path, text: str) -> None:
    note = bombs.chunk(b"tEXt", b"DepthScale\0" + text.encode())
    path = picture(tmp_path / "depth.png", np.ones((1, 1), np.uint16))
    path.write_bytes(path.read_bytes()[:33] + note + path.read_bytes()[33:])
    assert declared_scale(path) is None
    assert read_stored(path).scale is None


def test_text_of_a_png(tmp_path: Path) -> None:
    path = picture(tmp_path / "a.png", np.array([[7]], np.uint8))
    path.write_bytes(path.read_bytes()[:33] + bombs.chunk(b"tEXt", b"offset\0-1.5") + path.read_bytes()[33:])
    values, text = read_png_with_text(path)
    assert (values.tolist(), text) == ([[7]], {"offset": "-1.5"})


def test_mask_may_have_one_bit_and_a_map_may_not(tmp_path: Path) -> None:
    path = picture(tmp_path / "mask.png", np.array([[True, False]]))
    assert read_mask(path).values.tolist() == [[True, False]]
    with pytest.raises(InputError, match=r"mask\.png.*mode '1'"):
        read_png(path)


def test_maps_from_memory(tmp_path: Path) -> None:
    path = picture(tmp_path / "depth.png", np.array([[500]], np.uint16))
    assert read_stored(Memory(path.read_bytes(), "a.tar, sample 3", ".png")).values.tolist() == [[500]]
    with pytest.raises(InputError, match=r"a\.tar, sample 3.*not inside a shard"):
        read_stored(Memory(b"", "a.tar, sample 3", ".exr"))


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize("orientation", [None, 1, 3, 6])
def test_map_is_turned_upright_as_photos_are(tmp_path: Path, suffix: str, orientation: int | None) -> None:
    levels = np.array([[1, 2, 3], [4, 5, 60000]], np.uint16)
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    Image.fromarray(levels).save(tmp_path / f"a{suffix}", exif=exif)
    stored = read_stored(tmp_path / f"a{suffix}")
    turned = {3: levels[::-1, ::-1], 6: np.rot90(levels, -1)}.get(orientation, levels)
    np.testing.assert_array_equal(stored.values, turned)
    assert stored.orientation == (orientation or 1)


def test_relative_depth_of_this_package_says_so(tmp_path: Path) -> None:
    write_relative_png(tmp_path / "a.png", METRES)
    assert read_stored(tmp_path / "a.png").relative
    write_depth_png(tmp_path / "a.png", METRES)
    assert not read_stored(tmp_path / "a.png").relative


def test_large_notes_of_a_png_do_not_hide_its_depth(tmp_path: Path) -> None:
    """A profile or text beyond 1 MB is passed over, wherever it stands; the scale beside it is found."""
    path = picture(tmp_path / "depth.png", np.array([[500]], np.uint16))
    content = path.read_bytes()
    large = zlib.compress(b"a" * 3_000_000)
    path.write_bytes(
        content[:33]
        + bombs.chunk(b"iCCP", b"scanner\0\0" + large)
        + bombs.chunk(b"tEXt", b"workflow\0" + b"a" * 2_000_000)
        + bombs.chunk(b"tEXt", b"DepthScale\x001000")
        + content[33:-12]
        + bombs.chunk(b"zTXt", b"later\0\0" + large)
        + content[-12:]
    )
    assert read_depth(path).tolist() == [[0.5]]
    assert declared_scale(path) == 1000
    assert read_png_with_text(path)[1] == {"DepthScale": "1000"}


def test_page_of_depth_is_the_only_full_one(tmp_path: Path) -> None:
    depth, preview, other = (Image.fromarray(np.full((4, 6), value, np.uint16)) for value in (500, 7, 9))
    path = tmp_path / "depth.tif"
    path.write_bytes(bombs.tiff_pages((preview, {254: 1}), (depth, {}), (preview, {254: 1})).getvalue())
    assert (read_depth(path, scale=1000) == 0.5).all()
    other.save(path, save_all=True, append_images=[depth])
    with pytest.raises(InputError, match=r"depth\.tif.*several pages: save the one of depth alone"):
        read_depth(path, scale=1000)


def test_what_is_not_known_is_0(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[np.nan, np.inf, -np.inf, -1, 1e300, 2]]))
    assert read_depth(tmp_path / "a.npy").tolist() == [[0, 0, 0, 0, 0, 2]]


def test_relative_depth_is_not_read_as_metres(tmp_path: Path) -> None:
    write_relative_png(tmp_path / "a.png", METRES)
    with pytest.raises(InputError, match=r"a\.png holds relative depth, which has no metres"):
        read_depth(tmp_path / "a.png", scale=1000)
