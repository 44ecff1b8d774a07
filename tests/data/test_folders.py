"""Folders of pairs without a list."""

import unicodedata
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.data.facts import Facts
from zoedepth.data.folders import find_pairs
from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.images import write_image
from zoedepth.outputs import Maps, write_maps
from zoedepth.outputs.depth import write_depth_png


def photo(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (2, 1), "grey").save(path)


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
    say(tmp_path, '{"domain": "indoor", "fx": 5, "fy": 6, "cx": 1, "cy": 0.25}')
    sample = PairDataset(tmp_path)[0]
    assert (sample.target[0].tolist(), sample.camera) == ([[1.5, 80]], Intrinsics(5, 6, 1, 0.25))


@pytest.mark.parametrize(
    ("text", "word"), [('{"domain": "indoor"}', "depth_scale.*dataset.json"), ("{}", "domain.*dataset.json")]
)
def test_error_says_where_to_write_what_nobody_says(tmp_path: Path, text: str, word: str) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    say(tmp_path, text)
    with pytest.raises(InputError, match=word):
        PairDataset(tmp_path)


def test_numbers_of_two_parts_are_names_and_no_times(tmp_path: Path) -> None:
    for number in range(1, 13):
        pair(tmp_path, "rgb", "depth", f"3.{number}")
    (tmp_path / "depth" / "3.1.png").unlink()  # 3.10 is as near in time
    say(tmp_path)
    with pytest.raises(InputError, match=r"1 photos without depth.*3\.1\.jpg"):
        PairDataset(tmp_path)


def test_a_folder_whose_disk_is_not_there_is_no_smaller_data_set(tmp_path: Path) -> None:
    pair(tmp_path, "rgb", "depth", "0")
    say(tmp_path)
    for half in ("rgb", "depth"):
        (tmp_path / half / "day2").symlink_to(f"/mnt/not/there/{half}")
    with pytest.raises(InputError, match=r"day2 is a link that leads nowhere: is its disk there"):
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


def test_names_that_look_the_same_go_together(tmp_path: Path) -> None:
    photo(tmp_path / "images" / f"{unicodedata.normalize('NFD', 'Küche')}.jpg")
    depth(tmp_path / "depth" / f"{unicodedata.normalize('NFC', 'Küche')}.png")
    say(tmp_path)
    assert PairDataset(tmp_path)[0].target[0].tolist() == [[0.5, 2]]


def test_two_names_that_look_the_same_are_an_error(tmp_path: Path) -> None:
    for form in ("NFC", "NFD"):
        photo(tmp_path / "images" / f"{unicodedata.normalize(form, 'Küche')}.jpg")
    depth(tmp_path / "depth" / "Küche.png")
    say(tmp_path)
    if len(list((tmp_path / "images").iterdir())) < 2:  # macOS keeps one of the two: nothing can be confused
        assert len(PairDataset(tmp_path)) == 1
        return
    with pytest.raises(InputError, match=r"names that look the same, with accents stored in different ways"):
        PairDataset(tmp_path)


def test_names_that_only_begin_alike_do_not_go_together(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "1", near=1000)
    pair(tmp_path, "images", "depth", "10", near=3000)
    pair(tmp_path, "images", "depth", "a/1", near=5000)
    say(tmp_path)
    dataset = PairDataset(tmp_path)
    assert [dataset[i].target[0, 0, 0].item() for i in range(3)] == [1, 3, 5]


@pytest.mark.parametrize("suffix", [".jpg", ".cr2", ".mat"])
@pytest.mark.parametrize("allow_missing", [False, True])
def test_depth_of_a_format_that_is_not_read_is_named(tmp_path: Path, suffix: str, allow_missing: bool) -> None:
    pair(tmp_path, "images", "depth", "0")
    (tmp_path / "depth" / "0.png").rename(tmp_path / "depth" / f"0{suffix}")
    say(tmp_path)
    with pytest.raises(InputError, match=rf"depth/0{suffix} cannot hold the depth of .*images/0\.jpg.*\.npy"):
        PairDataset(tmp_path, allow_missing=allow_missing)


def test_photo_of_a_format_that_is_not_read_is_named(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "0")
    pair(tmp_path, "images", "depth", "1")
    (tmp_path / "images" / "1.jpg").rename(tmp_path / "images" / "1.CR2")
    say(tmp_path)
    with pytest.raises(InputError, match=r"images/1\.CR2, the photo of .*depth/1\.png, is of a format"):
        PairDataset(tmp_path)
    (tmp_path / "images" / "0.jpg").unlink()
    with pytest.raises(InputError, match=r"no photos in .*images, but 1\.CR2.*\.jpg"):
        PairDataset(tmp_path)


def test_two_maps_that_may_be_the_depth_of_a_photo_are_an_error(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "0")
    depth(tmp_path / "depth" / "0_depth.png", near=999)  # a prediction beside the truth
    say(tmp_path)
    with pytest.raises(InputError, match=r"0\.png and .*0_depth\.png may both be the depth of 0"):
        PairDataset(tmp_path)


def test_more_folders_than_one_of_each_are_an_error(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "0")
    pair(tmp_path, "rgb", "depths", "0")
    say(tmp_path)
    with pytest.raises(InputError, match="the folders depth, depths, images, rgb: it is not clear"):
        PairDataset(tmp_path)


@pytest.mark.parametrize("stem", ["kitchen/1", "1"])
def test_photos_that_no_split_has_are_an_error(tmp_path: Path, stem: str) -> None:
    pair(tmp_path, "images", "depth", "train/0")
    pair(tmp_path, "images", "depth", stem)
    say(tmp_path)
    with pytest.raises(InputError, match=r"has the splits \['train'\], and .* in none of them"):
        PairDataset(tmp_path)


def test_linked_folders_are_searched_and_circles_are_not(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "a/0")
    pair(tmp_path / "elsewhere", "images", "depth", "1")
    for half in ("images", "depth"):
        (tmp_path / half / "b").symlink_to(tmp_path / "elsewhere" / half)
        (tmp_path / half / "a" / "circle").symlink_to(tmp_path / half)
    say(tmp_path)
    dataset = PairDataset(tmp_path)
    assert [dataset[i].name for i in range(len(dataset))] == ["images/a/0.jpg", "images/b/1.jpg"]


def test_what_this_package_wrote_beside_the_photos_is_no_photo(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "0")
    write_maps(tmp_path / "images" / "0_depth.png", Maps(np.ones((1, 2), np.float32)))
    write_image(tmp_path / "images" / "0_preview.jpg", np.zeros((1, 2, 3), np.uint8))
    say(tmp_path)
    for allow_missing in (False, True):
        assert [each.image.name for each in PairDataset(tmp_path, allow_missing=allow_missing).pairs] == ["0.jpg"]


def test_thumbnails_of_a_disk_station_are_no_photos(tmp_path: Path) -> None:
    pair(tmp_path, "images", "depth", "0")
    photo(tmp_path / "images" / "@eaDir" / "0.jpg" / "SYNOPHOTO_THUMB_M.jpg")
    say(tmp_path)
    assert len(PairDataset(tmp_path, allow_missing=True)) == 1


class TestTimes:
    """Names that are times of two clocks."""

    def test_nearest_go_together_in_each_folder(self, tmp_path: Path) -> None:
        for place, name in enumerate(["a/100.500000", "a/100.533333", "a/100.566666", "b/100.510000"], start=1):
            photo(tmp_path / "rgb" / f"{name}.png")
            if place != 2:
                folder, time = name.split("/")
                depth(tmp_path / "depth" / folder / f"{float(time) + 0.009:.6f}.png", near=1000 * place)
        say(tmp_path)
        dataset = PairDataset(tmp_path)
        found = [(dataset[i].name, dataset[i].target[0, 0, 0].item()) for i in range(len(dataset))]
        assert found == [("rgb/a/100.500000.png", 1), ("rgb/a/100.566666.png", 3), ("rgb/b/100.510000.png", 4)]
        assert [each.target is None for each in PairDataset(tmp_path, allow_missing=True).pairs] == [
            False, True, False, False,
        ]  # fmt: skip

    @pytest.mark.parametrize(
        ("of_photo", "of_depth", "message"),
        [
            pytest.param("100.500", "200.500", r"are times, and no two are within 0\.02 s", id="none-near-enough"),
            pytest.param("000001", "000002", "Names must agree", id="numbers-of-frames-are-no-times"),
        ],
    )
    def test_others_are_an_error(self, tmp_path: Path, of_photo: str, of_depth: str, message: str) -> None:
        photo(tmp_path / "rgb" / f"{of_photo}.png")
        depth(tmp_path / "depth" / f"{of_depth}.png")
        say(tmp_path)
        with pytest.raises(InputError, match=message):
            PairDataset(tmp_path)


def test_few_files_without_their_other_half_are_kept_with_the_file_that_is_missing(tmp_path: Path) -> None:
    for name in ("1", "2", "a/3", "4"):
        for folder, suffix in (("images", "jpg"), ("depth", "png")):
            if (name, folder) not in {("2", "depth"), ("a/3", "images")}:
                (tmp_path / folder / name).parent.mkdir(parents=True, exist_ok=True)
                (tmp_path / folder / f"{name}.{suffix}").touch()
    facts = Facts(1000, "indoor")
    pairs = find_pairs(tmp_path, split="train", defaults=facts, keep_missing=True)
    missing = [path for pair in pairs for path in pair.files if not path.exists()]
    assert len(pairs) == 4
    assert missing == [tmp_path / "depth/2.png", tmp_path / "images/a/3.jpg"]
    (tmp_path / "images/4.jpg").unlink()
    (tmp_path / "images/5.jpg").touch()
    with pytest.raises(InputError, match="2 photos without depth"):
        find_pairs(tmp_path, split="train", defaults=facts, keep_missing=True)
