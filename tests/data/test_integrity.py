"""Files that are cut short, missing or of other sizes are found without reading all of them."""

import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import bombs
from tests.folders import write_csv, write_pairs

from zoedepth.data import integrity
from zoedepth.data.integrity import find_broken, most_broken, named
from zoedepth.data.pairs import PairDataset


@pytest.fixture
def pairs(tmp_path: Path) -> PairDataset:
    """Five pairs of JPEG and PNG that are in order."""
    return PairDataset(write_pairs(tmp_path, n=5, size=(16, 24)), keep_missing=True)


def cut(path: Path, share: float = 0.5) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def test_files_in_order_are_looked_at_and_not_read(pairs: PairDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PairDataset, "__getitem__", None)
    done: list[tuple[int, int]] = []
    assert find_broken(pairs, progress=lambda *numbers: done.append(numbers)) == {}
    assert done == [(5, 5)]


def test_photo_and_depth_cut_short_are_named(pairs: PairDataset) -> None:
    cut(pairs.pairs[1].image)
    assert pairs.pairs[3].target is not None
    cut(pairs.pairs[3].target)
    pairs.pairs[4].image.write_bytes(b"")
    pairs.pairs[0].image.unlink()
    found = find_broken(pairs)
    assert sorted(found) == [0, 1, 3, 4]
    for index, name in ((0, "train_000.jpg"), (1, "train_001.jpg"), (3, "train_003.png"), (4, "train_004.jpg")):
        assert name in found[index]


def test_a_photo_of_another_size_is_named_and_a_photo_with_bytes_behind_it_is_none(pairs: PairDataset) -> None:
    Image.new("RGB", (30, 16)).save(pairs.pairs[2].image)
    with pairs.pairs[0].image.open("ab") as file:  # phones append films
        file.write(b"a film" * 100)
    assert sorted(find_broken(pairs)) == [2]


def test_large_photos_are_looked_at_without_a_warning(pairs: PairDataset) -> None:
    assert pairs.pairs[0].target is not None
    for path in (pairs.pairs[0].image, pairs.pairs[0].target):
        path.write_bytes(bombs.png(12_000, 9_000))  # which would be refused if it were read
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert find_broken(pairs) == {}


def test_a_picture_in_place_of_depth_is_named(pairs: PairDataset) -> None:
    for index, mode in ((1, "L"), (3, "RGB")):
        path = pairs.pairs[index].target
        assert path is not None
        Image.new(mode, (24, 16), 9 if mode == "L" else (9, 9, 9)).save(path)
    found = find_broken(pairs)
    assert sorted(found) == [1, 3]
    assert "train_001.png has 8 bits a pixel" in found[1]


def test_every_sample_is_read_if_asked_for(pairs: PairDataset) -> None:
    path = pairs.pairs[1].target
    assert path is not None
    png = bytearray(path.read_bytes())
    place = png.index(b"IDAT") + 4
    png[place : place + 4] = b"\0\0\0\0"
    path.write_bytes(png)
    assert find_broken(pairs) == {}
    assert list(find_broken(pairs, full=True)) == [1]


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff"])
def test_other_formats_of_depth(tmp_path: Path, suffix: str) -> None:
    rows = []
    for i in range(2):
        Image.new("RGB", (24, 16), (9, 9, 9)).save(tmp_path / f"{i}.webp", lossless=True)
        depth, path = np.random.default_rng(i).random((16, 24)).astype(np.float32), tmp_path / f"{i}{suffix}"
        if suffix == ".tiff":
            Image.fromarray(depth).save(path)
        else:
            np.save(path, depth) if suffix == ".npy" else np.savez_compressed(path, depth=depth)
        rows.append({"image": f"{i}.webp", "depth": path.name, "domain": "indoor"})
    dataset = PairDataset(write_csv(tmp_path / "train.csv", rows))
    assert find_broken(dataset) == {}
    cut(tmp_path / f"1{suffix}", 0.9)
    if suffix == ".tiff":  # whose end looks like any other
        assert find_broken(dataset, full=True).keys() == {1}
    else:
        assert find_broken(dataset).keys() == {1}
    cut(tmp_path / "0.webp")
    assert 0 in find_broken(dataset)


def test_photos_without_truth_are_not_looked_at(tmp_path: Path) -> None:
    row = {"image": "image/train_000.jpg", "depth_scale": 1000, "domain": "indoor"}
    write_pairs(tmp_path, n=1, size=(16, 24))
    path = write_csv(tmp_path / "list.csv", [{**row, "depth": "None"}, {**row, "depth": "depth/train_000.png"}])
    assert find_broken(PairDataset(path, allow_missing=True), full=True) == {}


def test_samples_without_files_of_their_own_are_read_if_asked_for(pairs: PairDataset) -> None:
    cut(pairs.pairs[1].image)

    class Rows:
        def __len__(self) -> int:
            return len(pairs)

        def __getitem__(self, index: int):
            return pairs[index]

    assert find_broken(Rows()) == {}
    assert list(find_broken(Rows(), full=True)) == [1]


def test_many_files_are_looked_at_in_parts(pairs: PairDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integrity, "_CHUNK", 2)
    done: list[int] = []
    cut(pairs.pairs[4].image)
    assert list(find_broken(pairs, progress=lambda n, total: done.append(n))) == [4]
    assert done == [2, 4, 5]


def test_some_may_be_broken_and_few_are_named() -> None:
    assert [most_broken(n) for n in (1, 9, 20, 212, 100_000)] == [1, 1, 2, 21, 10_000]
    assert named(["a", "b", "c"], most=2) == "a; b; and 1 more, which zoedepth data check lists"


def test_archive_without_its_end_is_suspicious(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("depth.npy", b"0" * 1000)
    assert integrity._ends_well(tmp_path / "a.npz")
    cut(tmp_path / "a.npz")
    assert not integrity._ends_well(tmp_path / "a.npz")
