""" "-" on the command line: a photo from standard input, a file to standard output."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory

from zoedepth.errors import InputError
from zoedepth.jobs.inputs import source_kind

STREAM = "-"

_MAX_PHOTO = 1 << 29  # bytes of a photo from standard input, as of other streams


@contextmanager
def standard_streams(
    sources: tuple[str, ...], out: Path, *, kinds: Sequence[str], json_: bool
) -> Iterator[tuple[tuple[str, ...], Path]]:
    """Give the sources and the folder to work with: as they are, or where one is "-", files that stand for streams.

    What was written to the folder is handed on to standard output when the block ends well.

    Args:
        sources: photos and folders; "-" is standard input.
        out: folder to write to; "-" is standard output.
        kinds: names of the outputs that are written for a photo.
        json_: standard output gets lines of JSON.

    Raises:
        InputError: more than one file would go to standard output, it is a terminal, or it is no place for the files of
            a photo from standard input; or standard input holds nothing, or more than 512 MiB.
    """
    if STREAM not in sources and str(out) != STREAM:
        yield sources, out
        return
    _check(sources, out, kinds=kinds, json_=json_)
    with TemporaryDirectory() as folder:
        photo, files = sources[0], Path(folder, "files")
        if photo == STREAM:
            photo = str(Path(folder, "stdin"))
            Path(photo).write_bytes(_standard_input())
        yield (photo,), files
        for file in files.iterdir() if files.is_dir() else ():
            if file.suffix != ".json":  # the sidecar
                with file.open("rb") as opened:
                    copyfileobj(opened, sys.stdout.buffer)
        sys.stdout.flush()


def _check(sources: tuple[str, ...], out: Path, *, kinds: Sequence[str], json_: bool) -> None:
    if str(out) != STREAM:
        raise InputError(
            "a photo from standard input (-) has no name, so that its files would have none: give --out -, or save the "
            "photo as a file"
        )
    if len(sources) != 1 or (sources[0] != STREAM and source_kind(sources[0]) not in ("photo", "address of a photo")):
        raise InputError("--out - writes one file to standard output: give one photo, or a folder as --out")
    if len(kinds) != 1:
        raise InputError(
            f"--out - writes one file to standard output, not {' and '.join(kinds)}: give one kind, e.g. --save png"
        )
    if json_:
        raise InputError("--json and --out - both write to standard output: give one of them")
    if getattr(sys.stdout, "name", None) == os.devnull:  # see cli.main
        raise InputError("--out - writes to standard output, which is closed: open it, or give a folder")
    if sys.stdout.isatty():
        raise InputError("--out - would write a file to the terminal: send it somewhere, e.g. > depth.png")


def _standard_input() -> bytes:
    content = sys.stdin.buffer.read(_MAX_PHOTO + 1)
    if not content:
        raise InputError("standard input (-) holds no photo: it is empty")
    if len(content) > _MAX_PHOTO:
        raise InputError(f"standard input (-) holds more than {_MAX_PHOTO:,} bytes: no photo is as large")
    return content
