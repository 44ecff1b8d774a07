"""Files of scores: what is torn, old or somebody else's in the folder."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.identity import Stamps
from zoedepth.evaluation.score_files import ScoreFiles
from zoedepth.evaluation.scoring import Score
from zoedepth.metrics import Sums

NAME = "scores-0-of-1.jsonl"
HEADER = {"about": {"source": "ours", "weights": "1234"}, "protocols": {"indoor": "nyu#1"}}


@dataclass
class Photos:
    """A source whose photos have a version each."""

    versions: dict[str, int] = field(default_factory=dict)

    def state(self, name: str) -> object:
        return self.versions.get(name, 0)


def score_of(index: int) -> Score:
    return Score(f"{index}.jpg", "indoor", None, Sums(n_pixels=index + 1, rel=0.5))


def files_of(folder: Path, source: Photos | None = None, *, n: int = 3, header: dict = HEADER) -> ScoreFiles:
    return ScoreFiles(folder, header, Stamps(source or Photos(), [None] * n, {}))


def write(folder: Path, source: Photos | None = None, *, n: int = 3, rank: int = 0, count: int = 1) -> None:
    """Write the scores of images that are not there yet."""
    files = files_of(folder, source, n=n)
    there = files.read()
    files.open(rank, count)
    for index in range(rank, n, count):
        if index not in there:
            files.add(index, score_of(index), files.stamps.of_data(index))
    files.close()


def test_scores_are_read_as_they_were_written(tmp_path: Path) -> None:
    write(tmp_path)
    assert files_of(tmp_path).read() == {index: score_of(index) for index in range(3)}


def test_old_scores_are_counted_left_out_and_replaced(tmp_path: Path) -> None:
    write(tmp_path)
    changed = Photos({"1.jpg": 1})
    files = files_of(tmp_path, changed)
    assert list(files.read()) == [0, 2]
    assert files.n_stale == 1
    write(tmp_path, changed)
    assert [json.loads(line)["index"] for line in (tmp_path / NAME).read_text().splitlines()[1:]] == [0, 2, 1]
    files = files_of(tmp_path, changed)
    assert (sorted(files.read()), files.n_stale) == ([0, 1, 2], 0)


def test_file_without_anything_old_is_not_written_again(tmp_path: Path) -> None:
    write(tmp_path)
    before = (tmp_path / NAME).stat()
    write(tmp_path)
    assert (tmp_path / NAME).stat().st_ino == before.st_ino
    assert (tmp_path / NAME).stat().st_mtime_ns == before.st_mtime_ns


def test_images_that_the_data_no_longer_has_are_dropped_without_a_word(tmp_path: Path) -> None:
    write(tmp_path, n=3)
    files = files_of(tmp_path, n=2)
    assert (sorted(files.read()), files.n_stale) == ([0, 1], 0)
    write(tmp_path, n=2)
    assert len((tmp_path / NAME).read_text().splitlines()) == 3


def test_process_that_is_alone_tidies_the_files_of_others_and_one_among_several_its_own(tmp_path: Path) -> None:
    for rank in (0, 1):
        write(tmp_path, rank=rank, count=2)
    changed = Photos({"0.jpg": 1, "1.jpg": 1})
    write(tmp_path, changed, rank=0, count=2)
    others = tmp_path / "scores-1-of-2.jsonl"
    assert len(others.read_text().splitlines()) == 2
    write(tmp_path, changed)
    assert others.read_text() == json.dumps(HEADER) + "\n"
    assert sorted(files_of(tmp_path, changed).read()) == [0, 1, 2]


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line[: len(line) // 2],
        lambda line: "\0" * len(line),
        lambda line: "[1, 2]",
        lambda line: '{"index": 1}',
        lambda line: line.replace('"index": 1', '"index": "one"'),
        lambda line: line.replace("n_pixels", "pixels"),
        lambda line: "\udcff",
    ],
    ids=["cut", "zeros", "list", "fields", "type", "name", "no text"],
)
def test_line_that_is_no_score_costs_only_its_own_image(tmp_path: Path, damage: Callable[[str], str]) -> None:
    write(tmp_path)
    lines = (tmp_path / NAME).read_text().split("\n")
    lines[2] = damage(lines[2])
    (tmp_path / NAME).write_text("\n".join(lines), encoding="utf-8", errors="surrogateescape")
    assert list(files_of(tmp_path).read()) == [0, 2]
    write(tmp_path)
    assert list(files_of(tmp_path).read()) == [0, 1, 2]
    assert len((tmp_path / NAME).read_text().splitlines()) == 4


@pytest.mark.parametrize("text", ["", "\0\0\0\0", "{", '{"abo', '{"about": {"sou'])
def test_first_line_that_was_being_written_is_written_again(tmp_path: Path, text: str) -> None:
    (tmp_path / NAME).write_text(text)
    write(tmp_path)
    assert (tmp_path / NAME).read_text().startswith(json.dumps(HEADER) + "\n")
    assert len(files_of(tmp_path).read()) == 3


@pytest.mark.parametrize(
    "text", ["notes", "rel,rmse\n0.1,0.2\n", "{}\n", "[]\n", '{"about": "me"}\n', '{"about": {}\n{}']
)
def test_file_of_somebody_else_stays(tmp_path: Path, text: str) -> None:
    (tmp_path / NAME).write_text(text)
    with pytest.raises(InputError, match=rf"{NAME} is no file of scores .*another --out, or move it"):
        files_of(tmp_path)
    assert (tmp_path / NAME).read_text() == text


def test_folder_of_the_name_of_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / NAME).mkdir()
    with pytest.raises(InputError, match=rf"{NAME} is no file"):
        files_of(tmp_path)


def test_scores_of_another_command_are_refused_and_the_difference_is_said(tmp_path: Path) -> None:
    write(tmp_path)
    other = {"about": {"source": "ours", "kind": "depth"}, "protocols": {"indoor": "nyu#2"}}
    with pytest.raises(InputError) as raised:
        files_of(tmp_path, header=other)
    text = str(raised.value)
    assert "kind was None and is 'depth', protocols was {'indoor': 'nyu#1'} and is {'indoor': 'nyu#2'}, weights" in text
    assert "source" not in text
    assert f"remove {tmp_path}" in text
