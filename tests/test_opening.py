"""One function for all data: what is opened as what, and what goes before what."""

import builtins
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.folders import write_pairs

from zoedepth.data.pairs import PairDataset
from zoedepth.datasets import DATASETS
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.opening import open_dataset
from zoedepth.shards.dataset import ShardDataset
from zoedepth.shards.writer import ShardSize, write_shards


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two pairs and their train.csv."""
    write_pairs(tmp_path / "pairs", n=2, size=(8, 12))
    return tmp_path / "pairs"


@pytest.fixture
def shards(folder: Path, tmp_path: Path) -> Path:
    """Both pairs in one shard."""
    write_shards(PairDataset(folder), tmp_path / "shards", name="data", size=ShardSize(samples=9))
    return tmp_path / "shards"


def write_nyu(root: Path) -> None:
    """One pair of NYU in its official folder."""
    scene = root / "sync" / "kitchen"
    scene.mkdir(parents=True)
    Image.new("RGB", (4, 3)).save(scene / "rgb_00000.jpg")
    Image.fromarray(np.full((3, 4), 2000, np.uint16)).save(scene / "sync_depth_00000.png")


def test_files_by_their_suffix(folder: Path, shards: Path) -> None:
    (folder / "some.jsonl").write_text(
        '{"image": "image/train_000.jpg", "depth": "depth/train_000.png", "depth_scale": 1000, "domain": "indoor"}'
    )
    (folder / "some.txt").write_text("image/train_000.jpg depth/train_000.png 500")
    assert len(open_dataset(folder / "train.csv")) == 2
    assert len(open_dataset(folder / "some.jsonl")) == 1
    assert len(open_dataset(folder / "some.txt", depth_scale=1000, domain="indoor")) == 1
    assert len(open_dataset(shards / "index.json")) == len(open_dataset(str(shards / "data-000000.tar"))) == 2


def test_folders_by_what_is_in_them(folder: Path, shards: Path) -> None:
    assert isinstance(open_dataset(folder), PairDataset)
    (folder / "train.csv").unlink()
    pairs = open_dataset(folder, depth_scale=1000, domain="indoor")
    assert isinstance(pairs, PairDataset)
    assert pairs.path == folder
    assert isinstance(open_dataset(shards), ShardDataset)
    (shards / "index.json").unlink()
    assert isinstance(open_dataset(shards), ShardDataset)


def test_published_set_by_its_name(tmp_path: Path) -> None:
    write_nyu(tmp_path)
    dataset = open_dataset(tmp_path, name="nyu")
    assert isinstance(dataset, DATASETS["nyu"])
    assert dataset[0].target.unique().tolist() == [2]
    with pytest.raises(InputError, match="folders of photos and depth; accepted are: "):
        open_dataset(tmp_path)


def test_lists_and_indices_of_your_own_go_before_a_published_name(folder: Path, shards: Path) -> None:
    assert isinstance(open_dataset(folder, name="nyu"), PairDataset)
    assert isinstance(open_dataset(shards, name="nyu"), ShardDataset)


def test_archives_in_the_folder_of_a_published_set_are_not_taken_for_shards(tmp_path: Path) -> None:
    write_nyu(tmp_path)
    (tmp_path / "download.tar").write_bytes(b"whatever")
    assert len(open_dataset(tmp_path, name="nyu")) == 1


def test_split_chooses_the_list_or_the_folder_of_shards(folder: Path, shards: Path, tmp_path: Path) -> None:
    write_pairs(folder, n=1, size=(8, 12), split="test")
    assert [len(open_dataset(folder, split=split)) for split in ("train", "test")] == [2, 1]
    write_shards(PairDataset(folder, split="test"), tmp_path / "all" / "test", name="data", size=ShardSize(samples=9))
    shutil.move(shards, tmp_path / "all" / "train")
    assert [len(open_dataset(tmp_path / "all", split=split)) for split in ("train", "test")] == [2, 1]
    (tmp_path / "all/dataset.json").write_text('{"max_depth": 5}')
    with pytest.raises(InputError, match=r"all/dataset\.json is not beside the shards .*: move it to \S*all/test"):
        open_dataset(tmp_path / "all", split="test")
    shutil.move(tmp_path / "all/dataset.json", tmp_path / "all/test/dataset.json")
    assert open_dataset(tmp_path / "all", split="test").max_depth == 5


def test_photos_without_depth_where_allowed(folder: Path) -> None:
    path = folder / "train.csv"
    path.write_text(path.read_text().replace("depth/train_001.png", "None"))
    assert len(open_dataset(path, allow_missing=True)) == len(open_dataset(folder, allow_missing=True)) == 2
    for source in (path, folder):
        with pytest.raises(InputError, match="1 photos without depth"):
            open_dataset(source)


@pytest.mark.parametrize("name", ["photo.jpg", "data.csv.gz", "data.tar.gz", "other.json"])
def test_file_of_another_kind_is_an_error_that_says_what_is_accepted(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match=rf"{name} is not data in a known format; accepted are: [^$]*\.jsonl"):
        open_dataset(tmp_path / name)


def test_what_is_not_there_is_an_error_that_says_what_is_accepted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no .*nowhere; accepted are: "):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"none of test\.csv, test\.jsonl, index\.json.*'mine' is no published"):
        open_dataset(tmp_path, name="mine", split="test")


@pytest.mark.parametrize("address", ["https://host/photos.zip", "https://host/", "http:/host/index.json"])
def test_address_of_something_else_is_an_error(address: str) -> None:
    with pytest.raises(InputError, match="address"):
        open_dataset(address)


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def refuse(name: str, *arguments: object) -> object:
        if name == "datasets":
            raise ImportError(name)
        return original(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingExtraError, match=r"zoedepth\[hf\]"):
        open_dataset("hf:owner/name", domain="indoor")


def test_scenes_that_are_made_up() -> None:
    from zoedepth.synthetic import SyntheticScenes

    rooms = open_dataset("synthetic:rooms?n=7&seed=3&size=48x64")
    assert isinstance(rooms, SyntheticScenes)
    assert (len(rooms), rooms.seed, rooms.size, list(rooms.domains)) == (7, 3, (48, 64), ["indoor"])
    assert list(open_dataset("synthetic:streets").domains) == ["outdoor"]
    assert rooms.fields_of_view is None
    for address, fields in (("?fov=35-100.5", (35, 100.5)), ("?n=3&fov=60", (60, 60))):
        assert open_dataset(f"synthetic:all{address}").fields_of_view == fields
    assert len(open_dataset("synthetic:all")) == 10_000


@pytest.mark.parametrize(
    "address",
    [
        "synthetic:", "synthetic:caves", "synthetic:rooms?n=many", "synthetic:rooms?size=48", "synthetic:rooms?count=7",
        "synthetic:rooms?fov=wide", "synthetic:rooms?fov=100-35", "synthetic:rooms?fov=0",
    ],
)  # fmt: skip
def test_scenes_that_nobody_makes_up(address: str) -> None:
    with pytest.raises(InputError, match=r"synthetic:|fields of view"):
        open_dataset(address)


def test_root_is_where_the_files_of_a_list_are(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "lists").mkdir()
    for suffix in ("csv", "tsv"):
        text = (folder / "train.csv").read_text()
        path = tmp_path / "lists" / f"some.{suffix}"
        path.write_text(text.replace(",", "\t") if suffix == "tsv" else text)
        assert open_dataset(path, root=folder)[1].name == str(Path("image/train_001.jpg"))
        with pytest.raises(InputError, match="--root names another"):
            open_dataset(path)


def test_two_lists_of_a_split_are_an_error(folder: Path) -> None:
    (folder / "train.jsonl").write_text("{}")
    with pytest.raises(InputError, match=r"has both train\.csv and train\.jsonl: give one"):
        open_dataset(folder)


def test_folder_without_a_list_has_no_use_for_a_root(folder: Path, tmp_path: Path) -> None:
    (folder / "train.csv").unlink()
    sample = open_dataset(folder, root=tmp_path, depth_scale=1000, domain="indoor")[0]
    assert sample.name == str(Path("image/train_000.jpg"))


@pytest.mark.parametrize("suffix", [".pfm", ".pgm"])
def test_portable_maps_in_a_folder(tmp_path: Path, suffix: str) -> None:
    for half in ("rgb", "depth"):
        (tmp_path / half).mkdir()
    Image.new("RGB", (2, 1), "grey").save(tmp_path / "rgb" / "a.jpg")
    content = {
        ".pfm": b"Pf\n2 1\n-1\n" + np.array([0.5, 2], "<f4").tobytes(),
        ".pgm": b"P5 2 1 4095 " + np.array([500, 2000], ">u2").tobytes(),
    }
    (tmp_path / "depth" / f"a{suffix}").write_bytes(content[suffix])
    assert open_dataset(tmp_path, depth_scale=1000, domain="indoor")[0].target[0].tolist() == [[0.5, 2]]
    if suffix == ".pgm":
        with pytest.raises(InputError, match=r"nobody says the depth_scale of a\.pgm"):
            open_dataset(tmp_path, domain="indoor")


@pytest.mark.parametrize(("there", "asked"), [("test", "train"), ("train", "test")])
def test_the_list_of_another_split_is_not_passed_over(tmp_path: Path, there: str, asked: str) -> None:
    folder = write_pairs(tmp_path / "rooms", split=there, n=2)
    folder = folder if folder.is_dir() else folder.parent
    (folder / "dataset.json").write_text('{"domain": "indoor", "depth_scale": 1000}', encoding="utf-8")
    assert len(open_dataset(folder, split=there)) == 2
    with pytest.raises(InputError, match=rf"has {there}\.csv, and no {asked}\.csv or {asked}\.jsonl: give the list"):
        open_dataset(folder, split=asked)
