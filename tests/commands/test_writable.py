"""A result that could not be written is refused before the work, and a try leaves nothing behind."""

import errno
import tempfile
from pathlib import Path

import pytest

from zoedepth.commands.writable import check_writable
from zoedepth.errors import InputError


@pytest.mark.parametrize("name", ["", "there", "not/yet/there"])
def test_folders_that_can_be_written_to_are_left_as_they_were(tmp_path: Path, name: str) -> None:
    (tmp_path / "there").mkdir()
    check_writable(tmp_path / name)
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_file_in_place_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(InputError, match=rf"--out {path}: cannot write.*Choose a folder"):
            check_writable(path)
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="cannot write"):
        check_writable(tmp_path / "link/below")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EROFS])
def test_what_the_system_says_is_told(tmp_path: Path, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**_: object) -> None:
        raise OSError(code, "the reason")

    monkeypatch.setattr(tempfile, "TemporaryFile", fail)
    with pytest.raises(InputError, match=rf"--sheet {tmp_path}/new: cannot write in {tmp_path} \(the reason\)"):
        check_writable(tmp_path / "new", option="--sheet")
