"""Tar files whose headers cannot exhaust memory or time, whatever they claim."""

import re
import tarfile
from typing import IO, Any

from zoedepth.stored.files import BoundedFile

MAX_HEADER = 1 << 16
"""The most bytes of a tar file that are read at once, and so the longest header: 64 KiB."""

_DIGITS = re.compile(rb"\d{256}")  # a file's name has at most 255 bytes


def open_tar(file: IO[bytes]) -> Any:
    """Open a tar file that is not compressed, or that ``file`` unpacks.

    A ``ValueError`` is raised where a header claims to be longer than ``MAX_HEADER``. So members are read by that many
    bytes at once, too.

    Returns:
        A ``TarFile``, whose list of members its types leave out.
    """
    bounded: Any = _Headers(file, max_bytes=MAX_HEADER)  # as much of a file as tarfile uses
    return tarfile.open(fileobj=bounded, mode="r:")


def check_end(file: IO[bytes], offset: int) -> None:
    """Check that a tar file ends here: the true end is empty or zeros, but ``tarfile`` also stops at a damaged header.

    Raises:
        tarfile.ReadError: something else stands there.
    """
    file.seek(offset)
    if any(file.read(tarfile.BLOCKSIZE)):
        raise tarfile.ReadError(f"no header at byte {offset:,}")


class _Headers(BoundedFile):
    """The headers of a tar file. ``tarfile`` takes seconds for 64 KiB of digits: it begins anew at each."""

    def read(self, size: int = -1) -> bytes:
        """Read ``size`` bytes."""
        content = super().read(size)
        if len(content) > tarfile.BLOCKSIZE and _DIGITS.search(content):
            raise ValueError("a header has a number of more than 255 digits")
        return content
