"""Folders of photos with depth: units, what is unknown, and every way a list or a file can be wrong."""

import tracemalloc
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_csv, write_disparity_pairs, write_pairs

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.outputs.depth import write_depth_png


def write_pair(folder: Path, stored: np.ndarray, **row: object) -> Path:
    """One grey photo with these stored values, listed in ``folder/train.csv`` with the columns of ``row``."""
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((*stored.shape, 3), 128, np.uint8)).save(folder / "photo.jpg")
    Image.fromarray(stored).save(folder / "target.png")
    return write_csv(folder / "train.csv", [{"image": "photo.jpg", **row}])


def test_depth_is_the_stored_value_over_its_scale_in_metres(tmp_path: Path) -> None:
    stored = np.array([[1500, 65535], [256, 1]], np.uint16)
    millimetres = write_pair(tmp_path / "a", stored, depth="target.png", depth_scale=1000, domain="indoor")
    kitti = write_pair(tmp_path / "b", stored, depth="target.png", depth_scale=256, domain="outdoor")

    torch.testing.assert_close(PairDataset(millimetres)[0].target[0], torch.tensor([[1.5, 65.535], [0.256, 0.001]]))
    torch.testing.assert_close(PairDataset(kitti)[0].target[0], torch.tensor([[5.859375, 255.99609], [1.0, 1 / 256]]))


def test_zero_is_unknown_and_everything_else_is_known(tmp_path: Path) -> None:
    stored = np.array([[0, 1, 0], [65535, 0, 7]], np.uint16)
    path = write_pair(tmp_path, stored, depth="target.png", depth_scale=1000, domain="indoor")

    sample = PairDataset(path)[0]

    assert sample.mask[0].tolist() == [[False, True, False], [True, False, True]]
    assert (sample.target[~sample.mask] == 0).all()


def test_sample_says_what_it_is(tmp_path: Path) -> None:
    sample = PairDataset(write_pairs(tmp_path, n=2, size=(20, 30), domain="outdoor"))[1]

    assert sample.image.shape == (3, 20, 30)
    assert sample.image.dtype == torch.float32
    assert 0 <= sample.image.min() < sample.image.max() <= 1
    assert (sample.kind, sample.domain, sample.name) == ("depth", "outdoor", str(Path("image/train_001.jpg")))


def test_disparity_is_given_as_stored_and_needs_neither_scale_nor_domain(tmp_path: Path) -> None:
    stored = np.array([[0, 1], [128, 255]], np.uint8)
    dataset = PairDataset(write_pair(tmp_path, stored, disparity="target.png"))

    sample = dataset[0]

    assert sample.kind == "disparity"
    assert sample.target[0].tolist() == [[0, 1], [128, 255]]
    assert sample.mask[0].tolist() == [[False, True], [True, True]]
    assert dataset.kinds == ["disparity"]


def test_disparity_may_have_sixteen_bits(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.array([[0, 300], [1, 65535]], np.uint16), disparity="target.png")
    assert PairDataset(path)[0].target[0].tolist() == [[0, 300], [1, 65535]]


def test_domains_and_kinds_are_those_of_all_lines(tmp_path: Path) -> None:
    write_pairs(tmp_path, n=1, domain="outdoor", split="a")
    write_pairs(tmp_path, n=1, domain="indoor", split="b")
    write_disparity_pairs(tmp_path, n=1)
    (tmp_path / "all.csv").write_text(
        "image,depth,disparity,depth_scale,domain\n"
        "image/a_000.jpg,depth/a_000.png,,256,outdoor\n"
        "image/b_000.jpg,depth/b_000.png,,1000,indoor\n"
        "image/still_000.jpg,,disparity/still_000.png,,\n"
    )
    dataset = PairDataset(tmp_path / "all.csv")

    assert len(dataset) == 3
    assert dataset.domains == ["", "indoor", "outdoor"]
    assert dataset.kinds == ["depth", "disparity"]


def test_folder_stands_for_the_list_of_its_split(tmp_path: Path) -> None:
    write_pairs(tmp_path, n=3, split="train")
    write_pairs(tmp_path, n=2, split="test")

    assert len(PairDataset(tmp_path)) == 3
    assert len(PairDataset(tmp_path, split="test")) == 2
    assert len(PairDataset(str(tmp_path / "test.csv"))) == 2


def test_other_columns_are_left_alone(tmp_path: Path) -> None:
    stored = np.array([[1000]], np.uint16)
    path = write_pair(tmp_path, stored, depth="target.png", depth_scale=1000, focal=500.0, note="a, b", domain="indoor")
    assert PairDataset(path)[0].target.item() == 1.0


def test_list_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.array([[1000]], np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())  # as spreadsheets write it
    assert PairDataset(path)[0].target.item() == 1.0


def test_missing_list_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        PairDataset(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match=r"train\.csv"):
        PairDataset(tmp_path)


@pytest.mark.parametrize("text", ["", "image,depth,depth_scale,domain\n"], ids=["empty", "only a header"])
def test_list_without_pairs_is_an_error_that_names_it(tmp_path: Path, text: str) -> None:
    (tmp_path / "train.csv").write_text(text)
    with pytest.raises(InputError, match=r"train\.csv"):
        PairDataset(tmp_path)


@pytest.mark.parametrize(
    "content",
    [b"image,depth,depth_scale,domain\n\xff\xfe.jpg,d.png,1000,indoor\n", bytes(range(256)) * 4],
    ids=["not utf-8", "binary"],
)
def test_list_that_is_no_text_is_an_error_that_names_it(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "train.csv").write_bytes(content)
    with pytest.raises(InputError, match=r"train\.csv"):
        PairDataset(tmp_path)


@pytest.mark.parametrize(
    ("bad", "word"),
    [
        ({"image": ""}, "image"),
        ({"depth": ""}, "depth"),
        ({"disparity": "target.png"}, "disparity"),
        ({"domain": ""}, "domain"),
        ({"depth_scale": ""}, "depth_scale"),
        ({"depth_scale": "mm"}, "depth_scale"),
        ({"depth_scale": "0"}, "depth_scale"),
        ({"depth_scale": "-1000"}, "depth_scale"),
        ({"depth_scale": "nan"}, "depth_scale"),
        ({"depth_scale": "inf"}, "depth_scale"),
        ({"image": "../photo.jpg"}, "inside the folder"),
        ({"image": "a/../../photo.jpg"}, "inside the folder"),
        ({"image": "/photo.jpg"}, "inside the folder"),
        ({"depth": "../target.png"}, "inside the folder"),
        ({"depth": "/photo.jpg"}, "inside the folder"),
    ],
    ids=lambda value: "-".join(f"{k}={v}" for k, v in value.items()) if isinstance(value, dict) else "",
)
def test_malformed_line_is_an_error_that_names_file_line_and_field(
    tmp_path: Path, bad: dict[str, str], word: str
) -> None:
    good = {"image": "photo.jpg", "depth": "target.png", "disparity": "", "depth_scale": "1000", "domain": "indoor"}
    write_csv(tmp_path / "train.csv", [good, good, {**good, **bad}, good])
    Image.fromarray(np.ones((1, 1), np.uint16)).save(tmp_path / "target.png")  # one that does not say its scale

    with pytest.raises(InputError, match=word) as raised:
        PairDataset(tmp_path)

    assert str(tmp_path / "train.csv") in str(raised.value)
    assert "line 4" in str(raised.value)


@pytest.mark.parametrize(("column", "line"), [("image", 1), ("depth", 1), ("depth_scale", 2), ("domain", 2)])
def test_missing_column_is_an_error_that_names_file_and_line(tmp_path: Path, column: str, line: int) -> None:
    row = {"image": "photo.jpg", "depth": "target.png", "depth_scale": "1000", "domain": "indoor"}
    del row[column]
    write_csv(tmp_path / "train.csv", [row])
    Image.fromarray(np.ones((1, 1), np.uint16)).save(tmp_path / "target.png")  # one that does not say its scale
    with pytest.raises(InputError, match=rf"train\.csv, line {line}.*{column}"):
        PairDataset(tmp_path)


def test_short_line_is_an_error_that_names_file_and_line(tmp_path: Path) -> None:
    (tmp_path / "train.csv").write_text("image,depth,depth_scale,domain\nphoto.jpg,target.png\n")
    with pytest.raises(InputError, match=r"train\.csv, line 2"):
        PairDataset(tmp_path)


def test_missing_files_are_counted_and_the_first_is_named_before_anything_is_read(tmp_path: Path) -> None:
    write_pairs(tmp_path, n=4)
    (tmp_path / "depth" / "train_001.png").unlink()
    (tmp_path / "image" / "train_003.jpg").unlink()
    with pytest.raises(InputError, match=r"2 files.*train_001\.png"):
        PairDataset(tmp_path)


def test_photo_without_depth_is_an_error_for_who_wants_to_learn_from_it(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=3)
    path.write_text(path.read_text().replace("depth/train_001.png", "None"))
    with pytest.raises(InputError, match=r"1 photos without depth.*train_001\.jpg"):
        PairDataset(path)


def test_photo_without_depth_is_a_sample_without_truth_where_allowed(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=2, size=(20, 30))
    path.write_text(path.read_text().replace("depth/train_001.png", "None"))
    dataset = PairDataset(path, allow_missing=True)

    sample = dataset[1]

    assert [pair.target is None for pair in dataset.pairs] == [False, True]
    assert dataset[0].mask.any()
    assert sample.target.shape == sample.mask.shape == (1, 20, 30)
    assert not sample.target.any()
    assert not sample.mask.any()
    assert (sample.kind, sample.domain, sample.name) == ("depth", "indoor", str(Path("image/train_001.jpg")))


def test_photo_without_depth_must_be_there_all_the_same(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=2)
    path.write_text(path.read_text().replace("depth/train_001.png", "None"))
    (tmp_path / "image" / "train_001.jpg").unlink()
    with pytest.raises(InputError, match=r"1 files.*train_001\.jpg"):
        PairDataset(path, allow_missing=True)


def test_photo_and_depth_of_different_size_are_an_error_that_names_both(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((4, 6), np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    Image.fromarray(np.ones((6, 4), np.uint16)).save(tmp_path / "target.png")
    with pytest.raises(InputError, match=r"photo\.jpg.*target\.png"):
        PairDataset(path)[0]


@pytest.mark.parametrize("kept", [0.0, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("name", ["photo.jpg", "target.png"])
def test_truncated_file_is_an_error_that_names_it(tmp_path: Path, name: str, kept: float) -> None:
    stored = np.random.default_rng(0).integers(1, 65536, (40, 40), dtype=np.uint16)
    path = write_pair(tmp_path, stored, depth="target.png", depth_scale=1000, domain="indoor")
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(kept * len(content))])
    with pytest.raises(InputError, match=name):
        PairDataset(path)[0]


@pytest.mark.parametrize("name", ["photo.jpg", "target.png"])
def test_file_that_is_no_picture_is_an_error_that_names_it(tmp_path: Path, name: str) -> None:
    path = write_pair(tmp_path, np.ones((4, 4), np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    (tmp_path / name).write_text("no picture")
    with pytest.raises(InputError, match=name):
        PairDataset(path)[0]


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P", "1"])
def test_depth_that_is_not_one_channel_of_8_or_16_bits_is_an_error(tmp_path: Path, mode: str) -> None:
    path = write_pair(tmp_path, np.ones((4, 4), np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    Image.new(mode, (4, 4), color=1 if mode in ("P", "1") else None).save(tmp_path / "target.png")
    with pytest.raises(InputError, match=r"target\.png"):
        PairDataset(path)[0]


def test_depth_in_a_lossy_format_is_an_error(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((4, 4), np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    Image.new("L", (4, 4)).save(tmp_path / "target.png", format="JPEG")
    with pytest.raises(InputError, match=r"target\.png"):
        PairDataset(path)[0]


# ------------------------------------------------------------------------------------------- what a line may say more


def test_camera_is_that_of_the_line(tmp_path: Path) -> None:
    row = {"depth": "target.png", "depth_scale": 1000, "domain": "indoor", "fx": 5, "fy": "6.5", "cx": 1, "cy": 0}
    assert PairDataset(write_pair(tmp_path, np.ones((2, 3), np.uint16), **row))[0].camera == Intrinsics(5, 6.5, 1, 0)


def test_without_camera_there_is_none(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="target.png", depth_scale=1000, domain="indoor")
    assert PairDataset(path)[0].camera is None


@pytest.mark.parametrize(
    "camera",
    [
        {"fx": 500},
        {"fx": 500, "fy": 500, "cx": 1, "cy": ""},
        {"fx": "wide", "fy": 500, "cx": 1, "cy": 1},
        {"fx": 0, "fy": 500, "cx": 1, "cy": 1},
        {"fx": 500, "fy": "inf", "cx": 1, "cy": 1},
    ],
    ids=["one", "three", "text", "zero", "infinite"],
)
def test_half_a_camera_is_an_error_that_names_file_and_line(tmp_path: Path, camera: dict[str, object]) -> None:
    row = {"depth": "target.png", "depth_scale": 1000, "domain": "indoor", **camera}
    with pytest.raises(InputError, match=r"train\.csv, line 2.*(fx, fy|focal)"):
        PairDataset(write_pair(tmp_path, np.ones((2, 3), np.uint16), **row))


@pytest.mark.parametrize("bits", [1, 8, 16])
def test_depth_is_unknown_where_the_mask_is_zero(tmp_path: Path, bits: int) -> None:
    row = {"depth": "target.png", "depth_scale": 1, "domain": "indoor", "mask": "mask.png"}
    path = write_pair(tmp_path, np.array([[1, 2, 0, 0]], np.uint16), **row)
    mask = np.array([[0, 1, 0, 1]], {1: bool, 8: np.uint8, 16: np.uint16}[bits])
    Image.fromarray(mask).save(tmp_path / "mask.png")

    sample = PairDataset(path)[0]

    assert sample.mask[0].tolist() == [[False, True, False, False]]
    assert sample.target[0].tolist() == [[0, 2, 0, 0]]


def test_mask_of_another_size_is_an_error_that_names_both_sizes(tmp_path: Path) -> None:
    row = {"depth": "target.png", "depth_scale": 1, "domain": "indoor", "mask": "mask.png"}
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), **row)
    Image.fromarray(np.ones((3, 2), np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match=r"\(2, 3\).*mask.*\(3, 2\)"):
        PairDataset(path)[0]


def test_missing_mask_is_an_error_and_an_empty_cell_is_none(tmp_path: Path) -> None:
    row = {"depth": "target.png", "depth_scale": 1, "domain": "indoor"}
    with pytest.raises(InputError, match=r"mask\.png"):
        PairDataset(write_pair(tmp_path, np.ones((2, 3), np.uint16), **row, mask="mask.png"))
    assert PairDataset(write_pair(tmp_path, np.ones((2, 3), np.uint16), **row, mask=""))[0].mask.all()


# ------------------------------------------------------------------------------------------------- formats and units


def write_float(path: Path, metres: np.ndarray) -> None:
    """Floats in the format of the suffix."""
    if path.suffix == ".npy":
        np.save(path, metres)
    elif path.suffix == ".npz":
        np.savez_compressed(path, depth=metres, confidence=metres)
    elif path.suffix == ".tiff":
        Image.fromarray(metres).save(path)
    else:
        OpenEXR = pytest.importorskip("OpenEXR")
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Z": metres}).write(str(path))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff", ".exr"])
def test_floats_are_metres_and_what_is_not_positive_is_unknown(tmp_path: Path, suffix: str) -> None:
    metres = np.array([[1.5, 0.0, -1.0], [np.nan, np.inf, 300.25]], np.float32)
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth=f"depth{suffix}", domain="indoor")
    write_float(tmp_path / f"depth{suffix}", metres)

    sample = PairDataset(path)[0]

    assert sample.target[0].tolist() == [[1.5, 0, 0], [0, 0, 300.25]]
    assert sample.mask[0].tolist() == [[True, False, False], [False, False, True]]


def test_floats_with_a_scale_are_divided_by_it(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((1, 2), np.uint16), depth="depth.npy", depth_scale=100, domain="indoor")
    np.save(tmp_path / "depth.npy", np.array([[150.0, 25.0]]))
    assert PairDataset(path)[0].target[0].tolist() == [[1.5, 0.25]]


@pytest.mark.parametrize("shape", [(2, 3, 1), (1, 2, 3)])
def test_an_axis_of_one_is_dropped(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="depth.npy", domain="indoor")
    np.save(tmp_path / "depth.npy", np.arange(1.0, 7.0).reshape(shape))
    assert PairDataset(path)[0].target[0].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_maps_stored_column_by_column_are_read_as_they_were(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="depth.npy", domain="indoor")
    np.save(tmp_path / "depth.npy", np.asfortranarray(np.arange(1.0, 7.0).reshape(2, 3)))
    assert PairDataset(path)[0].target[0].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_whole_numbers_of_which_nobody_says_the_unit_are_an_error(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((1, 2), np.uint16), depth="depth.npy", domain="indoor")
    np.save(tmp_path / "depth.npy", np.array([[1500, 250]], np.uint16))
    with pytest.raises(InputError, match=r"depth\.npy.*depth_scale"):
        PairDataset(path)[0]
    assert PairDataset(path, depth_scale=1000)[0].target[0].tolist() == [[1.5, 0.25]]


def test_default_unit_leaves_floats_in_metres_and_max_depth_is_said_once_or_in_a_line(tmp_path: Path) -> None:
    row = {"image": "photo.jpg", "depth": "depth.npy", "domain": "indoor"}
    path = write_pair(tmp_path, np.ones((1, 3), np.uint16), depth="depth.npy", domain="indoor")
    np.save(tmp_path / "depth.npy", np.array([[2.5, 8.0, 65504.0]], np.float32))
    (tmp_path / "dataset.json").write_text('{"depth_scale": 1000, "max_depth": 60}')
    assert PairDataset(path)[0].target[0].tolist() == [[2.5, 8.0, 0]]
    nearer = write_csv(tmp_path / "nearer.csv", [{**row, "max_depth": 5}])
    assert PairDataset(nearer)[0].target[0].tolist() == [[2.5, 0, 0]]


def test_pairs_whose_files_are_missing_are_listed_where_they_are_accepted(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((1, 1), np.uint16), depth="target.png", depth_scale=1, domain="indoor")
    (tmp_path / "photo.jpg").unlink()
    dataset = PairDataset(path, keep_missing=True)
    assert dataset.missing_files() == [tmp_path / "photo.jpg"]
    with pytest.raises(InputError, match=r"photo\.jpg"):
        dataset[0]


def test_png_of_this_package_says_its_own_unit(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((1, 2), np.uint16), depth="depth.png", domain="indoor")
    write_depth_png(tmp_path / "depth.png", np.array([[1.5, 200.0]], np.float32), scale=256)
    assert PairDataset(path)[0].target[0].tolist() == [[1.5, 200]]
    # What is said for files that do not say their own changes nothing.
    assert PairDataset(path, depth_scale=1000)[0].target[0].tolist() == [[1.5, 200]]


def test_what_the_line_says_goes_before_what_the_png_says(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((1, 1), np.uint16), depth="depth.png", depth_scale=512, domain="indoor")
    write_depth_png(tmp_path / "depth.png", np.array([[3.0]], np.float32), scale=256)
    assert PairDataset(path)[0].target.item() == 1.5


def test_what_lines_leave_out_may_be_said_once(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.array([[500, 2000]], np.uint16), depth="target.png")
    (tmp_path / "dataset.json").write_text(
        '{"depth_scale": 1000, "domain": "garden", "fx": 5, "fy": 6, "cx": 1, "cy": 0.25}'
    )
    sample = PairDataset(path)[0]
    assert sample.target[0].tolist() == [[0.5, 2]]
    assert (sample.domain, sample.camera) == ("garden", Intrinsics(5, 6, 1, 0.25))
    assert PairDataset(path, domain="cellar").domains == ["cellar"]  # who asks knows best
    assert PairDataset(path, depth_scale=1000)[0].target[0].tolist() == [[0.5, 2]]
    with pytest.raises(InputError, match=r"dataset\.json says depth_scale 1000, and 500 is asked for"):
        PairDataset(path, depth_scale=500)


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"depth_scale": "mm"}', '{"depth_scale": 0}', '{"domain": 3}', "[" * 9999]
)
def test_malformed_defaults_are_an_error_that_names_the_file(tmp_path: Path, text: str) -> None:
    path = write_pair(tmp_path, np.ones((1, 1), np.uint16), depth="target.png", depth_scale=1, domain="indoor")
    (tmp_path / "dataset.json").write_text(text)
    with pytest.raises(InputError, match=r"dataset\.json"):
        PairDataset(path)


class Unpickled:
    """Leaves a mark when it is unpickled."""

    def __reduce__(self) -> tuple:
        return Path.touch, (Path("unpickled"),)


def test_pickled_objects_are_refused_and_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    row = {"depth": "depth.npy", "domain": "indoor"}
    path = write_pair(tmp_path, np.ones((1, 1), np.uint16), **row)
    np.save(tmp_path / "depth.npy", np.array([[Unpickled()]], object), allow_pickle=True)
    with pytest.raises(InputError, match=r"depth\.npy"):
        PairDataset(path)[0]
    assert not Path("unpickled").exists()
    np.load(tmp_path / "depth.npy", allow_pickle=True)  # or else nothing was shown
    assert Path("unpickled").exists()


def npy_header(shape: tuple[int, ...]) -> bytes:
    """An .npy that says it holds as much, and holds nothing."""
    file = BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize(
    ("shape", "word"),
    [
        ((10**6, 10**6), "more than"),
        ((2, 3, 4), "one map"),
        ((6,), "one map"),
        ((0, 5), "one map"),
        ((9, 9), "cut short"),
    ],
)
def test_map_that_is_not_what_it_promises_is_an_error(tmp_path: Path, shape: tuple[int, ...], word: str) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="depth.npy", domain="indoor")
    (tmp_path / "depth.npy").write_bytes(npy_header(shape))
    with pytest.raises(InputError, match=rf"depth\.npy.*{word}"):
        PairDataset(path)[0]


def test_archive_that_unpacks_to_far_more_than_its_map_is_not_unpacked(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="depth.npz", domain="indoor")
    with zipfile.ZipFile(tmp_path / "depth.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", npy_header((2, 3)) + np.arange(1, 7, dtype="<f4").tobytes() + bytes(50_000_000))
    tracemalloc.start()
    try:
        assert PairDataset(path)[0].target[0].tolist() == [[1, 2, 3], [4, 5, 6]]
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff", ".exr"])
@pytest.mark.parametrize("kept", [0.0, 0.3, 0.8])
def test_damaged_depth_of_any_format_is_an_error_that_names_it(tmp_path: Path, suffix: str, kept: float) -> None:
    path = write_pair(tmp_path, np.ones((40, 40), np.uint16), depth=f"depth{suffix}", domain="indoor")
    file = tmp_path / f"depth{suffix}"
    write_float(file, np.random.default_rng(0).random((40, 40), np.float32))
    file.write_bytes(file.read_bytes()[: int(kept * file.stat().st_size)])
    with pytest.raises(InputError, match=file.name):
        PairDataset(path)[0]


def test_format_nobody_keeps_depth_in_is_an_error(tmp_path: Path) -> None:
    path = write_pair(tmp_path, np.ones((2, 3), np.uint16), depth="photo.jpg", depth_scale=1, domain="indoor")
    with pytest.raises(InputError, match=r"photo\.jpg.*\.npz"):
        PairDataset(path)[0]


def test_line_without_end_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "train.csv").write_text("image,depth,depth_scale,domain\n" + "x" * 3_000_000)
    with pytest.raises(InputError, match=r"train\.csv"):
        PairDataset(tmp_path)
