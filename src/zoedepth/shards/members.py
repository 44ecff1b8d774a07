"""The members of a sample in a tar file: their names, and to bytes and back."""

import re
import tarfile
from collections.abc import Iterable, Mapping
from io import BytesIO
from typing import IO, NamedTuple

from zoedepth.data.sample import Target
from zoedepth.errors import InputError
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.stored import DEPTH_SUFFIXES

MAX_SAMPLE = 1 << 28
"""Bytes of a sample, at most: 256 MiB."""

MAX_JSON = 1 << 16
"""Bytes of a sample's JSON, at most."""

# webdataset's rule: the key ends at the first dot of the file's name.
_NAME = re.compile(r"((?:.*/)?[^./][^./]*)\.([^/]+)", re.DOTALL)
_PHOTOS = ("", "image", "rgb")
_TARGETS: dict[str, Target] = {"depth": "depth", "depth_map": "depth", "disparity": "disparity"}


class Roles(NamedTuple):
    """Which member, by its extension, is what."""

    photo: str
    target: str
    kind: Target
    mask: str | None


def split_name(name: str) -> tuple[str, str] | None:
    """(key, extension in lower case) of a member; None where it has not both."""
    found = _NAME.fullmatch(name)
    return (found[1], found[2].lower()) if found else None


def find_roles(extensions: Iterable[str], where: str) -> Roles:
    """The photo, target and mask among the extensions of a sample; others are left alone.

    Raises:
        InputError: not exactly one photo and one target.
    """
    extensions = sorted(extensions)
    photos = [name for name in extensions if _matches(name, _PHOTOS, IMAGE_SUFFIXES)]
    targets = [name for name in extensions if _matches(name, _TARGETS, DEPTH_SUFFIXES)]
    if len(photos) != 1 or len(targets) != 1:
        raise InputError(f"{where}: needs one photo (.jpg, .png …) and one .depth.png or .depth.npz; has {extensions}")
    kind = _TARGETS[targets[0].partition(".")[0]]
    return Roles(photos[0], targets[0], kind, "mask.png" if "mask.png" in extensions else None)


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """The bytes of a sample in a tar file, the same whenever and by whomever they are written."""
    blocks = []
    for extension, content in sorted(members.items()):
        header = tarfile.TarInfo(f"{key}.{extension}")  # no owner, the first of January 1970
        header.size = len(content)
        blocks += [header.tobuf(tarfile.USTAR_FORMAT), content, b"\0" * (-len(content) % tarfile.BLOCKSIZE)]
    return b"".join(blocks)


def unpack(block: bytes, where: str) -> dict[str, bytes]:
    """Extension → content of the members of a sample.

    Raises:
        InputError: the block is damaged; ``where`` says which.
    """
    found: dict[str, bytes] = {}
    try:
        with tarfile.open(fileobj=BytesIO(block), mode="r:") as archive:
            while (member := archive.next()) is not None:
                name = split_name(member.name)
                if name is None or not member.isreg() or member.issparse():
                    continue
                if name[1] in found:
                    raise InputError(f"{where}: has two members .{name[1]}")
                content = block[member.offset_data : member.offset_data + member.size]
                if len(content) != member.size:
                    raise tarfile.ReadError(f"{member.name!r} is cut short")
                found[name[1]] = content
            check_end(BytesIO(block), archive.offset)
    except (tarfile.TarError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: the shard is damaged ({error})") from error
    return found


def check_end(file: IO[bytes], offset: int) -> None:
    """``tarfile`` takes a damaged header for the end of the file; the true end is empty, or zeros.

    Raises:
        tarfile.ReadError: something else stands there.
    """
    file.seek(offset)
    if any(file.read(tarfile.BLOCKSIZE)):
        raise tarfile.ReadError(f"no header at byte {offset:,}")


def _matches(extension: str, names: Iterable[str], suffixes: Iterable[str]) -> bool:
    name, _, suffix = extension.rpartition(".")
    return name in names and f".{suffix}" in suffixes
