"""The members of a sample in a tar file: what their names mean, and how they become bytes and come back."""

import re
import tarfile
from collections.abc import Iterable, Mapping
from io import BytesIO
from typing import NamedTuple

from zoedepth.data.sample import Target
from zoedepth.errors import InputError
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.stored import DEPTH_SUFFIXES
from zoedepth.stored.tars import check_end, open_tar

MAX_SAMPLE = 1 << 28
"""The most bytes that a sample may have: 256 MiB."""

MAX_JSON = 1 << 16
"""The most bytes that the JSON of a sample may have."""

_MAX_MEMBERS = 100

# webdataset's rule: the key ends at the first dot of the file's name.
_NAME = re.compile(r"((?:.*/)?[^./][^./]*)\.([^/]+)", re.DOTALL)
_PHOTOS = ("", "image", "rgb")
_TARGETS: dict[str, Target] = {"depth": "depth", "depth_map": "depth", "disparity": "disparity"}


class Roles(NamedTuple):
    """The extensions of the members of a sample, by what they are."""

    photo: str
    target: str
    kind: Target
    mask: str | None


def split_name(name: str) -> tuple[str, str] | None:
    """Split the name of a member into (key, extension in lower case); None where it lacks one of them."""
    found = _NAME.fullmatch(name)
    return (found[1], found[2].lower()) if found else None


def find_roles(extensions: Iterable[str], where: str) -> Roles:
    """Find the photo, target and mask among the extensions of a sample; others are ignored.

    Raises:
        InputError: there is not exactly one photo and one target.
    """
    extensions = sorted(extensions)
    photos = [name for name in extensions if _matches(name, _PHOTOS, IMAGE_SUFFIXES)]
    targets = [name for name in extensions if _matches(name, _TARGETS, DEPTH_SUFFIXES)]
    if len(photos) != 1 or len(targets) != 1:
        raise InputError(
            f"{where}: needs one photo (.jpg, .png …) and one .depth.png or .depth.npz; it has {extensions}"
        )
    if wrong := [name for name in extensions if name.partition(".")[0] == "mask" and name != "mask.png"]:
        raise InputError(
            f"{where}: its mask .{wrong[0]} is not read. Save masks as .mask.png, 0 where depth is unknown"
        )
    kind = _TARGETS[targets[0].partition(".")[0]]
    return Roles(photos[0], targets[0], kind, "mask.png" if "mask.png" in extensions else None)


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Return the bytes of a sample in a tar file, which are the same whoever writes them and when."""
    blocks = []
    for extension, content in sorted(members.items()):
        header = tarfile.TarInfo(f"{key}.{extension}")  # no owner, the first of January 1970
        header.size = len(content)
        blocks += [header.tobuf(tarfile.USTAR_FORMAT), content, b"\0" * (-len(content) % tarfile.BLOCKSIZE)]
    return b"".join(blocks)


def unpack(block: bytes, where: str) -> dict[str, bytes]:
    """Return extension → content of the members of a sample.

    Raises:
        InputError: the block is damaged, or has very many members; ``where`` says which block it is.
    """
    found: dict[str, bytes] = {}
    try:
        with open_tar(BytesIO(block)) as archive:
            while (member := archive.next()) is not None:
                archive.members = []  # it would keep them all
                name = split_name(member.name)
                if name is None or not member.isreg() or member.issparse():
                    continue
                if name[1] in found or len(found) == _MAX_MEMBERS:
                    raise InputError(f"{where}: has two members .{name[1]}, or more than {_MAX_MEMBERS}")
                content = block[member.offset_data : member.offset_data + member.size]
                if len(content) != member.size:
                    raise tarfile.ReadError(f"{member.name!r} is cut short")
                found[name[1]] = content
            check_end(BytesIO(block), archive.offset)
    except (tarfile.TarError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: the shard is damaged, copy it again ({error})") from error
    return found


def _matches(extension: str, names: Iterable[str], suffixes: Iterable[str]) -> bool:
    name, _, suffix = extension.rpartition(".")
    return name in names and f".{suffix}" in suffixes
