"""Tar files: members are read, and headers that claim too much or are made to take time are refused."""

import io
import tarfile

import pytest

from zoedepth.stored.tars import MAX_HEADER, check_end, open_tar


def packed(content: bytes = b"abc", **headers: str) -> io.BytesIO:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as archive:
        info = tarfile.TarInfo("a.txt")
        info.size, info.pax_headers = len(content), headers
        archive.addfile(info, io.BytesIO(content))
    file.seek(0)
    return file


def test_members_are_read() -> None:
    with open_tar(packed(comment="short")) as archive:
        member = archive.next()
        assert archive.extractfile(member).read(MAX_HEADER) == b"abc"


@pytest.mark.parametrize(
    ("comment", "word"), [(" " * (MAX_HEADER + 1), "a header is too long"), ("7" * 1000, "more than 255 digits")]
)
def test_headers_that_are_too_long_are_refused(comment: str, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        open_tar(packed(comment=comment))


def test_end() -> None:
    file = packed()
    with open_tar(file) as archive:
        while archive.next() is not None:
            pass
        check_end(file, archive.offset)
        with pytest.raises(tarfile.ReadError, match="no header at byte 512"):
            check_end(file, 512)
