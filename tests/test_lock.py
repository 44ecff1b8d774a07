"""The lock: one command at a time; one that was killed locks nobody out."""

import errno
import os
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.jobs.manifest import only_command
from zoedepth.lock import only_one, this_process

HOLD = """
import sys
from pathlib import Path
from zoedepth.jobs.manifest import only_command
with only_command(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_another_process_has_it_until_it_is_killed(tmp_path: Path) -> None:
    manifest = tmp_path / "m.jsonl"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(manifest)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "held\n"
        message = f"another command works on .*process {process.pid} on .*--shard"
        with pytest.raises(InputError, match=message), only_command(manifest):
            pass
    finally:
        process.kill()
        process.wait()
    with only_command(manifest):
        assert (tmp_path / "m.jsonl.lock").read_text() == this_process()


def test_two_manifests_of_a_folder_are_no_matter(tmp_path: Path) -> None:
    with only_command(tmp_path / "a.jsonl"), only_command(tmp_path / "b.jsonl"):
        pass


# The test lets fcntl.flock fail, which Windows does not have: there filelock asks for locks in another way.
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has locks of another kind, on every file system")
@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_where_the_file_system_knows_no_locks_a_file_stands_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    import fcntl

    def unsupported(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", unsupported)
    manifest, stand_in = tmp_path / "m.jsonl", tmp_path / "m.jsonl.held"
    for _ in range(2):  # it is given back
        with only_command(manifest):
            assert stand_in.is_file()
            with pytest.raises(InputError, match=r"delete .*m\.jsonl\.held"), only_command(manifest):
                pass
            assert stand_in.is_file()
        assert not stand_in.exists()


def test_a_folder_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write to"), only_command(tmp_path / "file" / "m.jsonl"):
        pass


def test_the_message_says_what_the_other_does_and_what_to_do(tmp_path: Path) -> None:
    def held() -> AbstractContextManager[None]:
        return only_one(tmp_path / "log", work="sleeps", advice="wake it")

    with held(), pytest.raises(InputError, match=r"^another command sleeps \(process .*\): wake it$"), held():
        pass
