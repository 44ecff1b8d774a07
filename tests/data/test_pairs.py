"""Folders of photos with depth: units, what is unknown, and every way a list or a file can be wrong."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_csv, write_disparity_pairs, write_pairs

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError


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
    path = write_pair(tmp_path, stored, depth="target.png", depth_scale=1000, fx=500.0, note="a, b", domain="indoor")
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

    with pytest.raises(InputError, match=word) as raised:
        PairDataset(tmp_path)

    assert str(tmp_path / "train.csv") in str(raised.value)
    assert "line 4" in str(raised.value)


@pytest.mark.parametrize("column", ["image", "depth", "depth_scale", "domain"])
def test_missing_column_is_an_error_that_names_file_and_line(tmp_path: Path, column: str) -> None:
    row = {"image": "photo.jpg", "depth": "target.png", "depth_scale": "1000", "domain": "indoor"}
    del row[column]
    write_csv(tmp_path / "train.csv", [row])
    with pytest.raises(InputError, match=rf"train\.csv, line 2.*{column}"):
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
