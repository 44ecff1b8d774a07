"""The folder of an evaluation: what can be written to, and whose files are replaced."""

import errno
import os
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.out_folder import REPORTS, check_folder


def test_folder_may_be_new_or_empty_or_hold_other_files(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    check_folder(tmp_path)
    check_folder(tmp_path / "new" / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("name", REPORTS)
def test_file_that_an_evaluation_did_not_write_is_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text('{"results": []}')
    with pytest.raises(InputError, match=rf"{name} is no evaluation's.*another --out"):
        check_folder(tmp_path)


@pytest.mark.parametrize("ours", ["report.json", "model/data/scores-0-of-1.jsonl"])
def test_report_of_an_evaluation_is_replaced(tmp_path: Path, ours: str) -> None:
    (tmp_path / ours).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / ours).write_text('{"zoedepth": "0.1", "results": []}')
    (tmp_path / "report.md").write_text("# Evaluation")
    check_folder(tmp_path)


@pytest.mark.parametrize("name", ["file", "file/report", "nowhere", "nowhere/report"])
def test_file_in_the_place_of_a_folder_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    with pytest.raises(InputError, match=rf"cannot write to .*{name}: .*{name.split('/')[0]} is no folder"):
        check_folder(tmp_path / name)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENOSPC, "No space left on device). Make room"),
        (errno.EROFS, "Read-only file system). Make room there, or choose another folder"),
    ],
)
def test_what_cannot_be_written_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, message) -> None:
    def refuse(_: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(InputError) as raised:
        check_folder(tmp_path / "report")
    assert f"cannot write to {tmp_path / 'report'} ({message}" in str(raised.value)
    assert not list(tmp_path.iterdir())
