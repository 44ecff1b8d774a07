"""zoedepth data shard, by its function: options, messages, exit codes."""

from pathlib import Path

import pytest
import torch
import tyro
from tests.folders import write_pairs

from zoedepth.commands.shard import shard
from zoedepth.errors import InputError
from zoedepth.opening import open_dataset


def run(*arguments: object) -> int:
    return tyro.cli(shard, args=[str(argument) for argument in arguments])


def test_shards_have_the_samples_of_the_source(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    source = write_pairs(tmp_path / "pairs", n=3, size=(8, 12))

    assert run(source, tmp_path / "out", "--shard-size", 2, "--name", "rooms") == 0

    output = capsys.readouterr()
    assert output.out.strip() == str(tmp_path / "out")
    assert "3 samples in 2 shards" in output.err
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["index.json", "rooms-000000.tar", "rooms-000001.tar"]
    one, other = open_dataset(source), open_dataset(tmp_path / "out")
    assert all(torch.equal(one[i].target, other[i].target) for i in range(3))
    assert [other[i].name for i in range(3)] == [one[i].name for i in range(3)]


def test_options_reach_the_source(tmp_path: Path) -> None:
    write_pairs(tmp_path / "pairs", n=2, size=(8, 12))
    write_pairs(tmp_path / "pairs", n=1, size=(8, 12), split="test")
    assert run(tmp_path / "pairs", tmp_path / "test", "--split", "test") == 0
    for path in (tmp_path / "pairs").glob("*.csv"):
        path.unlink()
    assert run(tmp_path / "pairs", tmp_path / "all", "--depth-scale", 500, "--domain", "hall") == 0
    found = open_dataset(tmp_path / "all")
    assert (len(open_dataset(tmp_path / "test")), len(found), found.domains) == (1, 3, ["hall"])
    assert found[0].target.max() == 2 * open_dataset(tmp_path / "test")[0].target.max()  # sorted: the test photo first


def test_typed_again_it_does_nothing_more(tmp_path: Path) -> None:
    source = write_pairs(tmp_path / "pairs", n=2, size=(8, 12))
    run(source, tmp_path / "out")
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").iterdir()}
    assert run(source, tmp_path / "out") == 0
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").iterdir()} == before


def test_what_cannot_be_read_is_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    source = write_pairs(tmp_path / "pairs", n=4, size=(8, 12))
    photo = tmp_path / "pairs" / "image" / "train_001.jpg"
    photo.write_bytes(b"damaged")
    assert run(source, tmp_path / "out") == 1
    told = capsys.readouterr().err
    assert f"failed: sample 1: {photo}" in told
    assert "3 samples in 1 shards, 1 left out" in told
    assert run(source, tmp_path / "out") == 1
    assert "Left out before, and not tried again: samples 1. When" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--shard-size", "big"], "500MB"),
        (["--name", "a/b"], "letters"),
        (["--split", "x"], "x.csv"),
        (["--workers", "-1"], "--workers must be 1 or more"),
    ],
)
def test_wrong_options_write_nothing(tmp_path: Path, options: list[str], word: str) -> None:
    write_pairs(tmp_path / "pairs", n=1, size=(8, 12)).with_name("x").mkdir()
    (tmp_path / "pairs" / "image").rename(tmp_path / "pairs" / "photos") if "--split" in options else None
    with pytest.raises(InputError, match=word):
        run(tmp_path / "pairs", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_other_peoples_shards_are_not_replaced(tmp_path: Path) -> None:
    source = write_pairs(tmp_path / "pairs", n=1, size=(8, 12))
    (tmp_path / "out").mkdir()
    (tmp_path / "out/data-000000.tar").write_bytes(b"theirs")
    with pytest.raises(InputError, match=r"has data-000000\.tar without an index\.json"):
        run(source, tmp_path / "out")
    assert (tmp_path / "out/data-000000.tar").read_bytes() == b"theirs"
    assert run(source, tmp_path / "out", "--name", "rooms") == 0


def test_a_folder_that_cannot_be_written_to_is_an_error_before_anything_is_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"OUT: cannot write to \S*file"):
        run(tmp_path / "nowhere.csv", tmp_path / "file")
