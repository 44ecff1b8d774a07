"""Lists of pairs: JSON Lines, the text lists of BTS, tables in text files, and what their names may point to."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

GOOD = {"image": "photo.jpg", "depth": "depth.png", "depth_scale": 1000, "domain": "indoor"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A photo of one by two pixels, and its depth: 500 and 2000."""
    Image.new("RGB", (2, 1), "grey").save(tmp_path / "photo.jpg")
    Image.fromarray(np.array([[500, 2000]], np.uint16)).save(tmp_path / "depth.png")
    return tmp_path


def jsonl(folder: Path, *rows: object) -> Path:
    path = folder / "train.jsonl"
    path.write_text("".join(f"{row if isinstance(row, str) else json.dumps(row)}\n" for row in rows))
    return path


class TestJsonLines:
    def test_same_keys_as_a_csv(self, folder: Path):
        sample = PairDataset(jsonl(folder, {**GOOD, "fx": 5, "fy": 6.5, "cx": 1, "cy": -0.5, "note": ["left alone"]}))[
            0
        ]
        assert sample.target[0].tolist() == [[0.5, 2]]
        assert (sample.kind, sample.domain, sample.name) == ("depth", "indoor", "photo.jpg")
        assert sample.camera == Intrinsics(5, 6.5, 1, -0.5)

    def test_keys_of_metric3d(self, folder: Path):
        row = {
            "rgb": "photo.jpg",
            "depth": "depth.png",
            "depth_scale": 500,
            "cam_in": [5, 6, 1, 0.25],
            "domain": "indoor",
        }
        sample = PairDataset(jsonl(folder, row))[0]
        assert sample.target[0].tolist() == [[1, 4]]
        assert sample.camera == Intrinsics(5, 6, 1, 0.25)

    def test_folder_stands_for_the_list_of_its_split(self, folder: Path):
        jsonl(folder, GOOD, GOOD)
        assert len(PairDataset(folder, split="train")) == 2

    def test_empty_lines_are_left_out_but_counted(self, folder: Path):
        assert len(PairDataset(jsonl(folder, GOOD, "", "  ", GOOD))) == 2
        with pytest.raises(InputError, match="line 3"):
            PairDataset(jsonl(folder, GOOD, "", {**GOOD, "domain": ""}))

    @pytest.mark.parametrize("missing", [None, "None"])
    def test_no_depth_is_a_photo_without_truth_where_allowed(self, folder: Path, missing: str | None):
        path = jsonl(folder, GOOD, {**GOOD, "depth": missing})
        with pytest.raises(InputError, match="1 photos without depth"):
            PairDataset(path)
        assert [pair.target is None for pair in PairDataset(path, allow_missing=True).pairs] == [False, True]

    @pytest.mark.parametrize(
        "bad",
        [
            "{",
            "[]",
            "null",
            "3",
            "[" * 100_000,
            {**GOOD, "image": 3},
            {**GOOD, "image": ["photo.jpg"]},
            {**GOOD, "image": "../photo.jpg"},
            {**GOOD, "depth": "/depth.png"},
            {**GOOD, "mask": "../mask.png"},
            {**GOOD, "mask": True},
            {**GOOD, "depth_scale": True},
            {**GOOD, "depth_scale": [1000]},
            {**GOOD, "depth_scale": float("nan")},
            {**GOOD, "depth_scale": 10**400},
            {**GOOD, "depth_scale": -1},
            {**GOOD, "domain": ["indoor"]},
            {**GOOD, "disparity": "depth.png"},
            {**GOOD, "cam_in": [5, 6, 7]},
            {**GOOD, "cam_in": "5 6 7 8"},
            {**GOOD, "cam_in": [5, 6, 7, None]},
            {"depth": "depth.png", "depth_scale": 1000, "domain": "indoor"},
        ],
        ids=lambda bad: str(bad)[:60],
    )
    def test_malformed_line_is_an_error_that_names_file_and_line(self, folder: Path, bad: object):
        with pytest.raises(InputError, match=r"train\.jsonl, line 2"):
            PairDataset(jsonl(folder, GOOD, bad, GOOD).parent)

    def test_name_that_no_file_can_have_is_a_missing_file(self, folder: Path):
        with pytest.raises(InputError, match="2 files that do not exist"):
            PairDataset(jsonl(folder, {**GOOD, "image": "x" * 5000}, {**GOOD, "image": "a\0b.jpg"}))


def bts(folder: Path, text: str) -> Path:
    path = folder / "nyudepthv2_train_files_with_gt.txt"
    path.write_text(text)
    return path


class TestBTS:
    def test_paths_are_relative_to_the_list_with_or_without_a_slash(self, folder: Path):
        path = bts(folder, "/photo.jpg /depth.png 518.8579\nphoto.jpg depth.png 518.8579\n\nphoto.jpg depth.png\n")
        dataset = PairDataset(path, depth_scale=1000, domain="indoor")
        assert [dataset[i].target[0].tolist() for i in range(3)] == [[[0.5, 2]]] * 3
        assert (dataset[0].name, dataset[0].domain, dataset[0].camera) == ("photo.jpg", "indoor", None)

    def test_focal_length_is_the_camera_unless_the_whole_of_it_is_said(self, folder: Path):
        path = bts(folder, "photo.jpg depth.png 1.5\nphoto.jpg depth.png 0\nphoto.jpg depth.png nan\n")
        dataset = PairDataset(path, depth_scale=1000, domain="indoor")
        cameras = [dataset[i].camera for i in range(3)]
        assert cameras == [Intrinsics(1.5, 1.5, 0.5, 0.0), None, None]
        (folder / "dataset.json").write_text('{"cam_in": [1, 2, 1.5, 0.5]}')
        assert PairDataset(path, depth_scale=1000, domain="indoor")[0].camera == Intrinsics(1, 2, 1.5, 0.5)

    def test_unit_and_domain_may_stand_beside_it(self, folder: Path):
        (folder / "dataset.json").write_text('{"depth_scale": 500, "domain": "hall"}')
        sample = PairDataset(bts(folder, "photo.jpg depth.png 518.8579"))[0]
        assert (sample.target[0].tolist(), sample.domain) == ([[1, 4]], "hall")

    def test_none_is_a_photo_without_truth(self, folder: Path):
        path = bts(folder, "photo.jpg None 721.5377\n")
        assert not PairDataset(path, depth_scale=256, domain="outdoor", allow_missing=True)[0].mask.any()
        with pytest.raises(InputError, match="1 photos without depth"):
            PairDataset(path, depth_scale=256, domain="outdoor")

    @pytest.mark.parametrize("line", ["photo.jpg", "a b c", "photo.jpg depth.jpg 1"])
    def test_malformed_line_is_an_error_that_names_file_and_line(self, folder: Path, line: str):
        with pytest.raises(InputError, match=r"gt\.txt, line 2"):
            PairDataset(bts(folder, f"photo.jpg depth.png 1\n{line}\n"), depth_scale=1000, domain="indoor")

    @pytest.mark.parametrize(("told", "word"), [({"domain": "indoor"}, "depth_scale"), ({"depth_scale": 1}, "domain")])
    def test_what_nobody_says_is_an_error(self, folder: Path, told: dict, word: str):
        with pytest.raises(InputError, match=word):
            PairDataset(bts(folder, "photo.jpg depth.png 1"), **told)

    def test_a_text_that_is_no_list_is_an_error(self, folder: Path):
        with pytest.raises(InputError, match="lists no pairs"):
            PairDataset(bts(folder, "\n\n"))
        path = folder / "list.txt"
        path.write_bytes(bytes(range(256)))
        with pytest.raises(InputError, match="UTF-8"):
            PairDataset(path)


def test_table_may_be_in_a_text_file(folder: Path) -> None:
    path = folder / "list.txt"  # as a spreadsheet's "Unicode text"
    path.write_bytes("Image\tDepth\tDepth_Scale\tDomain\r\nphoto.jpg\tdepth.png\t1000\tindoor\r\n".encode("utf-16"))
    assert PairDataset(path)[0].target[0].tolist() == [[0.5, 2]]


def test_two_names_of_a_photo_are_an_error_unless_they_are_one(folder: Path) -> None:
    with pytest.raises(InputError, match=r"line 1: says two photos, image 'photo\.jpg' and rgb 'other\.jpg'"):
        PairDataset(jsonl(folder, {**GOOD, "rgb": "other.jpg"}))
    assert len(PairDataset(jsonl(folder, {**GOOD, "rgb": "photo.jpg"}))) == 1


@pytest.mark.parametrize("key", ["depth", "disparity"])
def test_lossy_depth_is_an_error_before_anything_is_read(folder: Path, key: str) -> None:
    with pytest.raises(InputError, match=rf"line 1: 'photo\.jpg' cannot hold {key}.*\.exr"):
        PairDataset(jsonl(folder, {"image": "photo.jpg", key: "photo.jpg", "depth_scale": 1, "domain": "indoor"}))


def test_a_depth_map_that_is_missing_is_said_to_be_missing_whoever_says_its_unit(folder: Path) -> None:
    unsaid = {key: value for key, value in GOOD.items() if key != "depth_scale"}
    path = jsonl(folder, GOOD, {**unsaid, "depth": "gone.png"})
    with pytest.raises(InputError, match=r"lists 1 files that do not exist, the first is .*gone\.png"):
        PairDataset(path)
    kept = PairDataset(path, keep_missing=True)
    assert [file.name for file in kept.missing_files()] == ["gone.png"]


def test_name_in_other_capitals_is_missing_and_named(folder: Path) -> None:
    if (folder / "PHOTO.JPG").exists():  # capitals do not count on macOS and Windows: the file is found
        assert len(PairDataset(jsonl(folder, {**GOOD, "image": "PHOTO.JPG"}))) == 1
        return
    with pytest.raises(InputError, match=r"first is .*PHOTO\.JPG\. There is photo\.jpg: capital letters count\. Its"):
        PairDataset(jsonl(folder, {**GOOD, "image": "PHOTO.JPG"}))


class TestElsewhere:
    """Files that are not below the list."""

    def test_root_is_where_the_files_are(self, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
        path = jsonl(tmp_path_factory.mktemp("lists"), GOOD)
        with pytest.raises(InputError, match=r"2 files that do not exist.*its own folder; --root names another"):
            PairDataset(path)
        dataset = PairDataset(path, root=folder)
        assert (dataset[0].name, dataset[0].target[0].tolist()) == ("photo.jpg", [[0.5, 2]])
        assert len(PairDataset(path.parent, root=folder)) == 1

    def test_absolute_paths_of_your_own_list_are_taken(
        self, folder: Path, tmp_path_factory: pytest.TempPathFactory
    ) -> None:
        path = jsonl(
            tmp_path_factory.mktemp("lists"),
            {**GOOD, "image": str(folder / "photo.jpg"), "depth": str(folder / "depth.png")},
        )
        dataset = PairDataset(path)
        # A name is a path below some folder, whoever makes one of it.
        assert dataset[0].name == str((folder / "photo.jpg").relative_to(folder.anchor))
        with pytest.raises(InputError, match=r"line 1: .*inside the folder of the list"):
            PairDataset(path.parent)
        assert PairDataset(path.parent, root=folder)[0].name == "photo.jpg"

    def test_paths_upwards_have_names_without_dots(self, folder: Path) -> None:
        (folder / "lists").mkdir()
        path = jsonl(folder / "lists", {**GOOD, "image": "../photo.jpg", "depth": "../depth.png"})
        assert PairDataset(path)[0].name == str((folder / "photo.jpg").relative_to(folder.anchor))

    def test_absolute_paths_in_a_text_list(self, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
        path = bts(tmp_path_factory.mktemp("lists"), f"{folder}/photo.jpg {folder}/depth.png 518.8579")
        assert PairDataset(path, depth_scale=1000, domain="indoor")[0].target[0].tolist() == [[0.5, 2]]
