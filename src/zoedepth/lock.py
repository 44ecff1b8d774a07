"""A lock, so that two commands do not do the same work in one folder."""

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from zoedepth.errors import InputError

_NO_LOCKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK}  # what file systems without locks answer


class HeldError(InputError):
    """The lock is another command's."""


def this_process() -> str:
    """Return the name of this process for people: its number, and the machine it runs on."""
    return f"process {os.getpid()} on {socket.gethostname()}"


def lock_file(file: Path) -> Path:
    """Return the file that is locked. It is not hidden: hidden ones are files that were left half written."""
    return file.with_name(f"{file.name}.lock")


@contextmanager
def only_one(file: Path, *, work: str, advice: str, wait_s: float = 0) -> Iterator[None]:
    """Hold the lock of a file until the block ends.

    The system holds the lock for the process, so that it is gone with the process, also after a kill or a crash. It
    works between machines where the file system hands locks on: NFS since version 4, Lustre and GPFS as they are
    usually mounted. Where a file system knows no locks, a file stands for it; one that a killed command left there must
    be deleted by hand, which the error says.

    Args:
        file: the file. The lock is another beside it, which stays (``lock_file``).
        work: the work of another command that has the lock, for the message: "another command ...".
        advice: the end of that message, for people who meet it.
        wait_s: seconds to wait for the lock.

    Raises:
        HeldError: another command has the lock.
        InputError: the file cannot be made.
    """
    from filelock import FileLock, SoftFileLock, Timeout

    path = lock_file(file)
    holder = _holder(path)  # before: filelock before version 4 empties the file when it asks for the lock
    lock = FileLock(path, timeout=wait_s, fallback_to_soft=False)
    try:
        try:
            lock.acquire()
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            path = path.with_suffix(".held")
            holder = _holder(path)
            lock = SoftFileLock(path, timeout=wait_s)
            advice = f"{advice}. If it does not run any more, delete {path}"
            lock.acquire()
    except Timeout as error:
        holder = _holder(path) if wait_s else holder  # it may have been another one's since
        raise HeldError(f"another command {work} ({holder}): {advice}") from error
    except OSError as error:
        raise InputError(f"cannot write to {file.parent} ({error.strerror or error})") from error
    try:
        with suppress(OSError):  # for the message above; Windows lets nobody write to a file with a lock
            path.write_text(this_process(), encoding="utf-8")
        yield
    finally:
        lock.release()


def _holder(path: Path) -> str:
    """Return who has the lock, as far as it says so."""
    try:
        return path.read_text(encoding="utf-8")[:200].strip() or "it does not say who"
    except (OSError, UnicodeDecodeError):
        return "it does not say who"
