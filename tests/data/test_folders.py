"""Folders of pairs without a list."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.outputs.depth import write_depth_png


def photo(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (2, 1)).save(path)


def depth(path: Path, near: int = 500) -> None:
    """Two values, whose unit the file does not say."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.array([[near, 2000]], np.uint16)).save(path)


def pair(folder: Path, photos: str, depths: str, stem: str, near: int = 500) -> None:
    photo(folder / photos / f"{stem}.jpg")
    depth(folder / depths / f"{stem}.png", near)


def say(folder: Path, text: str = '{"depth_scale": 1000, "domain": "indoor"}') -> None:
    (folder / "dataset.json").write_text(text)


@pytest.mark.parametrize(
    ("photos", "depths"), [("rgb", "depth"), ("image", "depth"), ("images", "depth"), ("images", "depths")]
)
def test_photos_go_with_the_depth_of_the_same_name(tmp_path: Path, photos: str, depths: str) -> None:
    for place, stem in enumerate(["b/0.1", "a/0", "a/1"]):
        pair(tmp_path, photos, depths, stem, near=1000 * (place + 1))
    say(tmp_path)
    dataset = PairDataset(tmp_path)
    found = [(dataset[i].name, dataset[i].target[0, 0, 0].item()) for i in range(len(dataset))]
    assert found == [(f"{photos}/a/0.jpg", 2), (f"{photos}/a/1.jpg", 3), (f"{photos}/b/0.1.jpg", 1)]
    assert (dataset.domains, dataset.kinds, dataset.path) == (["indoor"], ["depth"], tmp_path)


def test_splits_are_the_folders_below(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "train/0")
    pair(tmp_path, "images", "depth", "train/1")
    pair(tmp_path, "images", "depth", "val/2")
    say(tmp_path)
    assert len(PairDataset(tmp_path, split="train")) == 2
    assert [PairDataset(tmp_path, split="val")[0].name] == [str(Path("images/val/2.jpg"))]
    with pytest.raises(InputError, match=r"\['train', 'val'\].*'test'"):
        PairDataset(tmp_path, split="test")


def test_folder_without_splits_is_all_of_any(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "scene/0")
    say(tmp_path)
    assert len(PairDataset(tmp_path, split="test")) == len(PairDataset(tmp_path, split="train")) == 1


def test_unit_and_domain_may_be_told(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    sample = PairDataset(tmp_path, depth_scale=500, domain="hall")[0]
    assert (sample.target[0].tolist(), sample.domain) == ([[1, 4]], "hall")


def test_depth_predicted_by_this_package_needs_no_unit(tmp_path: Path) -> None:
    photo(tmp_path / "rgb" / "0.jpg")
    write_depth_png(tmp_path / "depth" / "0_depth.png", np.array([[1.5, 80]], np.float32), scale=256)
    (tmp_path / "depth" / "0.json").write_text("{}")
    photo(tmp_path / "depth" / "0_preview.jpg")
    assert PairDataset(tmp_path, domain="outdoor")[0].target[0].tolist() == [[1.5, 80]]


def test_floats_need_no_unit(tmp_path: Path) -> None:
    photo(tmp_path / "rgb" / "0.jpg")
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth" / "0.npy", np.array([[1.5, 80]]))
    say(tmp_path, '{"domain": "indoor", "fx": 5, "fy": 6, "cx": 7, "cy": 8}')
    sample = PairDataset(tmp_path)[0]
    assert (sample.target[0].tolist(), sample.camera) == ([[1.5, 80]], Intrinsics(5, 6, 7, 8))


@pytest.mark.parametrize(
    ("text", "word"), [('{"domain": "indoor"}', "depth_scale.*dataset.json"), ("{}", "domain.*dataset.json")]
)
def test_error_says_where_to_write_what_nobody_says(tmp_path: Path, text: str, word: str) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    say(tmp_path, text)
    with pytest.raises(InputError, match=word):
        PairDataset(tmp_path)


def test_halves_without_the_other_are_counted_and_named(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    photo(tmp_path / "rgb" / "1.jpg")
    photo(tmp_path / "rgb" / "2.jpg")
    depth(tmp_path / "depth" / "3.png")
    say(tmp_path)
    with pytest.raises(InputError, match=r"2 photos without depth.*1\.jpg.*1 depths without photo.*3\.png"):
        PairDataset(tmp_path)
    with pytest.raises(InputError, match=r"have 1 depths without photo"):
        PairDataset(tmp_path, allow_missing=True)
    (tmp_path / "depth" / "3.png").unlink()
    assert [pair.target is None for pair in PairDataset(tmp_path, allow_missing=True).pairs] == [False, True, True]


def test_two_files_of_one_name_are_an_error(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    photo(tmp_path / "rgb" / "0.png")
    say(tmp_path)
    with pytest.raises(InputError, match="the same name"):
        PairDataset(tmp_path)


def test_hidden_and_other_files_are_left_alone(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    photo(tmp_path / "rgb" / "._1.jpg")
    pair(tmp_path, "rgb", "depth", ".trash/2")
    (tmp_path / "depth" / "readme.md").write_text("depth")
    say(tmp_path)
    assert len(PairDataset(tmp_path)) == 1


def test_folder_without_photos_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    depth(tmp_path / "depth" / "0.png")
    say(tmp_path)
    with pytest.raises(InputError, match="no photos"):
        PairDataset(tmp_path)


def test_list_goes_before_the_folders(tmp_path: Path) -> None:
    pair(tmp_path, "image", "depth", "0")
    pair(tmp_path, "image", "depth", "1")
    (tmp_path / "train.csv").write_text("image,depth,depth_scale,domain\nimage/1.jpg,depth/1.png,1000,indoor\n")
    assert [PairDataset(tmp_path)[0].name] == [str(Path("image/1.jpg"))]
    assert len(PairDataset(tmp_path)) == 1
