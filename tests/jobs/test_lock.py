"""The lock: one command at a time; one that was killed locks nobody out."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.jobs.lock import only_one, this_process

HOLD = """
import sys
from pathlib import Path
from zoedepth.jobs.lock import only_one
with only_one(Path(sys.argv[1])):
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
        with pytest.raises(InputError, match=message), only_one(manifest):
            pass
    finally:
        process.kill()
        process.wait()
    with only_one(manifest):
        assert (tmp_path / "m.jsonl.lock").read_text() == this_process()


def test_two_manifests_of_a_folder_are_no_matter(tmp_path: Path) -> None:
    with only_one(tmp_path / "a.jsonl"), only_one(tmp_path / "b.jsonl"):
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
        with only_one(manifest):
            assert stand_in.is_file()
            with pytest.raises(InputError, match=r"delete .*m\.jsonl\.held"), only_one(manifest):
                pass
            assert stand_in.is_file()
        assert not stand_in.exists()


def test_a_folder_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write to"), only_one(tmp_path / "file" / "m.jsonl"):
        pass
