"""The parts that all published data sets share: lists, paths, missing files, sizes; on a set that is made up."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.datasets.base import write_photo

from zoedepth.datasets.published import MAX_LIST, About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics


class Attic(PublishedDataset):
    """Photos of an attic, 2 m deep everywhere but in the first column."""

    about = About(
        "Attic", "https://attic.example", "MIT", "depth", "attic", "\na.txt   (the list)\n", "none", {"test": 3}
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        rows = self.lines("a.txt", origin="from the attic")
        return [PairFiles(self.inside(row[0]), None if len(row) < 2 else self.inside(row[1])) for row in rows]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        known = np.ones((2, 3), bool)
        known[:, 0] = False
        return np.full((2, 3), 2.0), known

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        return Intrinsics(10, 10, 2.5, 1.5)


@pytest.fixture
def attic(tmp_path: Path) -> Path:
    """A list of three photos, of which the second has no depth."""
    for name in ("1.png", "2.png", "3.png"):
        write_photo(tmp_path / name, (4, 6))
    (tmp_path / "d").write_bytes(b"")
    (tmp_path / "a.txt").write_text("/1.png d\n\n2.png\n3.png  /d\n")
    return tmp_path


def test_photo_mask_and_camera_have_the_size_of_the_depth(attic: Path) -> None:
    sample = Attic(attic, split="test")[0]
    assert sample.image.shape == (3, 2, 3)
    assert sample.target[0].tolist() == [[0, 2, 2]] * 2
    assert sample.mask[0].tolist() == [[False, True, True]] * 2
    assert sample.camera == Intrinsics(10, 10, 2.5, 1.5).scaled(0.5, 0.5)
    assert (sample.name, sample.domain) == ("1.png", "attic")


def test_pairs_without_truth_are_there_where_allowed(attic: Path) -> None:
    assert len(Attic(attic, split="test")) == 2
    dataset = Attic(attic, split="test", allow_missing=True)
    assert len(dataset) == 3
    assert not dataset[1].mask.any()
    assert dataset[1].target.shape == (1, 4, 6)


def test_missing_files_are_counted_or_listed(attic: Path) -> None:
    (attic / "2.png").unlink()
    (attic / "d").unlink()
    with pytest.raises(InputError, match=r"3 files that belong to its 3 photos are missing, the first is .*d\."):
        Attic(attic, split="test")
    assert Attic(attic, split="test", allow_missing=True).missing_files() == [attic / "d", attic / "2.png", attic / "d"]
    assert len(Attic(attic, split="test", keep_missing=True).missing_files()) == 2  # the photo without truth is no pair


def test_split_that_is_not_there(attic: Path) -> None:
    with pytest.raises(InputError, match=r"Attic has no split 'train'; it has \['test'\]"):
        Attic(attic)


@pytest.mark.parametrize("name", ["../secret.png", "a/../../secret.png"])
def test_list_does_not_lead_out_of_the_folder(attic: Path, name: str) -> None:
    (attic / "a.txt").write_text(f"{name} d\n")
    with pytest.raises(InputError, match="leads out of"):
        Attic(attic, split="test")


@pytest.mark.parametrize("problem", ["missing", "binary", "endless", "empty"])
def test_error_about_a_list_says_where_to_get_it_and_how_the_folder_looks(attic: Path, problem: str) -> None:
    (attic / "a.txt").unlink()
    if problem == "endless":
        with (attic / "a.txt").open("wb") as file:
            file.truncate(MAX_LIST + 1)  # takes no room on the disk
    elif problem != "missing":
        (attic / "a.txt").write_bytes(b"\xff" if problem == "binary" else b"\n")
    with pytest.raises(
        InputError, match=r"^Attic: .*Expected:\n    a\.txt   \(the list\)\nGet it at https://attic"
    ) as caught:
        Attic(attic, split="test")
    assert ("get it from the attic" in str(caught.value)) == (problem != "empty")


def test_pattern_without_a_match_is_an_error_that_names_it(attic: Path) -> None:
    dataset = Attic(attic, split="test")
    assert dataset.find("*.png") == [attic / f"{number}.png" for number in (1, 2, 3)]
    with pytest.raises(InputError, match=r"there is no \*\.jpg in"):
        dataset.find("*.jpg")


@pytest.mark.parametrize(
    ("orientation", "size", "word"),
    [
        (3, (4, 6), "1.png is turned upright by its EXIF orientation 3, and nothing says whether .*d is, too"),
        (6, (6, 6), "EXIF orientation 6, and nothing says"),
        (6, (4, 6), r"1\.png is \(6, 4\) and .*d is \(2, 3\) \(height, width\): one of them lies on its side"),
        (1, (6, 4), "one of them lies on its side"),
    ],
)
def test_photo_that_may_lie_unlike_its_depth_is_an_error(
    attic: Path, orientation: int, size: tuple[int, int], word: str
) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    write_photo(attic / "1.png", size)
    with Image.open(attic / "1.png") as photo:
        photo.load()
    photo.save(attic / "1.png", exif=exif)
    with pytest.raises(InputError, match=word):
        Attic(attic, split="test")[0]


def test_square_photo_of_oblong_depth_is_only_squeezed(attic: Path) -> None:
    write_photo(attic / "1.png", (6, 6))
    assert Attic(attic, split="test")[0].image.shape == (3, 2, 3)
