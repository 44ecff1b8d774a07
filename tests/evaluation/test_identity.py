"""Stamps of kept scores: they are the same as long as nothing has changed that the scores depend on."""

from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from tests.evaluation.samples import FactorSource, photo
from tests.folders import write_pairs

import zoedepth.evaluation.identity as identity
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Samples
from zoedepth.evaluation.identity import Stamps, settings_fingerprint
from zoedepth.opening import open_dataset
from zoedepth.shards.dataset import ShardDataset
from zoedepth.shards.writer import ShardSize, write_shards


def test_settings_lie_in_the_folder_or_beside_the_list(tmp_path: Path) -> None:
    assert settings_fingerprint(str(tmp_path)) is None
    (tmp_path / "dataset.json").write_text('{"depth_scale": 256}')
    before = settings_fingerprint(str(tmp_path))
    assert before == settings_fingerprint(str(tmp_path / "test.csv")) is not None
    (tmp_path / "dataset.json").write_text('{"depth_scale": 100}')
    assert settings_fingerprint(str(tmp_path)) != before
    assert settings_fingerprint("synthetic:rooms") is None


def test_settings_of_shards_lie_beside_them(tmp_path: Path) -> None:
    folder = tmp_path / "all/test"
    write_shards(PairDataset(write_pairs(tmp_path, n=1)), folder, name="data", size=ShardSize(samples=9))
    data = open_dataset(tmp_path / "all", split="test")
    assert settings_fingerprint(str(tmp_path / "all"), data) is None
    (folder / "dataset.json").write_text('{"max_depth": 5}')
    assert settings_fingerprint(str(tmp_path / "all"), data) is not None


# ---------------------------------------------------------------------------------------------------- stamps


def stamps_of(data: Samples, *, source: object = None, **state: object) -> list[str]:
    """Return the stamps of all images, none of which is read."""
    stamps = Stamps(source, data, state)
    return [stamps.of(index, f"{index}.jpg") for index in range(len(data))]


def changed(before: list[str], after: list[str]) -> list[bool]:
    return [one != other for one, other in zip(before, after, strict=True)]


def edit(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda folder: None, [False, False]),
        (lambda folder: Image.new("L", (9, 9)).save(folder / "depth/test_001.png"), [False, True]),
        (lambda folder: Image.new("L", (9, 9)).save(folder / "image/test_000.jpg"), [True, False]),
        (lambda folder: Image.new("L", (9, 9)).save(folder / "mask.png"), [True, True]),
        (lambda folder: edit(folder / "test.csv", "1000", "100"), [True, True]),
        (lambda folder: edit(folder / "test.csv", "image/test_000", "image/test_001"), [True, False]),
        (lambda folder: edit(folder / "test.csv", "\n", "\r\n"), [False, False]),
    ],
    ids=["nothing", "depth", "photo", "mask", "scale", "order", "line ends"],
)
def test_pair_has_the_stamp_of_its_own_files_and_facts(
    tmp_path: Path, change: Callable[[Path], None], expected: list[bool]
) -> None:
    path = write_pairs(tmp_path, n=2, split="test")
    Image.new("L", (96, 64), 1).save(tmp_path / "mask.png")
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([f"{header},mask", *(f"{line},mask.png" for line in lines), ""]))
    before = stamps_of(PairDataset(path))
    change(tmp_path)
    assert changed(before, stamps_of(PairDataset(path))) == expected


def test_list_that_has_grown_keeps_its_stamps(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=3, split="test")
    whole = path.read_text()
    path.write_text("\n".join(whole.splitlines()[:3]) + "\n")
    before = stamps_of(PairDataset(path))
    path.write_text(whole)
    assert stamps_of(PairDataset(path))[:2] == before


def test_image_that_a_list_no_longer_has_has_no_stamp_of_data() -> None:
    stamps = Stamps(None, [photo((2, 2))], {})
    assert stamps.of_data(0)
    assert stamps.of_data(1) == stamps.of_data(-1) == ""


def test_published_set_has_the_stamps_of_its_files(tmp_path: Path) -> None:
    scene = tmp_path / "official_splits/test/kitchen"
    scene.mkdir(parents=True)
    for name in ("rgb_00045.jpg", "sync_depth_00045.png", "rgb_00046.jpg", "sync_depth_00046.png"):
        (scene / name).write_bytes(b"a")
    before = stamps_of(open_dataset(tmp_path, name="nyu", split="test"))
    (scene / "sync_depth_00046.png").write_bytes(b"ab")
    assert changed(before, stamps_of(open_dataset(tmp_path, name="nyu", split="test"))) == [False, True]


def test_shard_that_was_written_again_changes_all_stamps(tmp_path: Path) -> None:
    pairs = PairDataset(write_pairs(tmp_path / "pairs", n=2))
    write_shards(pairs, tmp_path / "shards", name="data", size=ShardSize(samples=9))
    before = stamps_of(ShardDataset(tmp_path / "shards"))
    assert stamps_of(ShardDataset(tmp_path / "shards")) == before
    (shard,) = (tmp_path / "shards").glob("*.tar")
    shard.write_bytes(shard.read_bytes())
    assert changed(before, stamps_of(ShardDataset(tmp_path / "shards"))) == [True, True]


def test_state_of_source_and_data_and_version_count(monkeypatch: pytest.MonkeyPatch) -> None:
    class Weights(FactorSource):
        weights = "a"

        def state(self, name: str) -> object:
            return [self.weights, name]

    data, source = [photo((2, 2))], Weights()
    before = stamps_of(data, source=source, settings="a")
    assert stamps_of(data, source=Weights(), settings="a") == before
    assert stamps_of(data, source=source, settings="b") != before
    source.weights = "b"
    assert stamps_of(data, source=source, settings="a") != before
    source.weights = "a"
    monkeypatch.setattr(identity, "__version__", "99")
    assert stamps_of(data, source=source, settings="a") != before
