"""Folders: the files below one, without those that other programs keep there, and whether one can be written to."""

import os
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path, PurePath
from tempfile import TemporaryFile

from zoedepth.errors import InputError

SERVICE_FOLDERS = (
    "@eadir", "#recycle", "#snapshot", "@tmp", "@sharebin",  # Synology
    "@synoresource", "@synodrive", "@mts", "@appstore", "@docker",
    "@recycle", "@recently-snapshot", "@__thumb", "@transcode", "@upload_cache",  # QNAP
    "trashbox", "~snapshot",  # Buffalo, NetApp
    "__macosx", "network trash folder", "temporary items", "thevolumesettingsfolder",  # Apple
    "$recycle.bin", "recycler", "system volume information", "found.[0-9]*", "lost+found", "lost.dir",
    "*.lrdata",  # Lightroom's previews
    "thmbnl",  # thumbnails of films on the cards of cameras
    "ipod photo cache",
)  # fmt: skip
"""Names of folders (lower case, with wildcards) in which other programs keep thumbnails, copies and deleted photos."""

_LIBRARIES = (".photoslibrary", ".photolibrary", ".aplibrary")
_ORIGINALS = ("originals", "masters")
"""In a library of Apple's programs, these folders hold the photos, and the others hold copies of them."""

_PROBE = 1 << 16


@dataclass
class Listing:
    """The files below a folder, and what was not looked at."""

    files: list[Path] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    """Why things were left out → how many."""
    unreadable: dict[str, str] = field(default_factory=dict)
    """Folder that cannot be read → what the system says."""


def list_files(folder: Path) -> Listing:
    """List the files below a folder, each once, in a fixed order: see ``walk_files``."""
    listing = Listing()
    for files in walk_files(folder, listing):
        listing.files.extend(files)
    return listing


def walk_files(folder: Path, listing: Listing) -> Iterator[list[Path]]:
    """Yield the files of one folder after the other, each once, in a fixed order.

    Links to folders are followed, but a folder is searched once, and a link that leads back up is not followed. Hidden
    files and folders are left out, and so are ``SERVICE_FOLDERS``; the folder itself may be either.

    Args:
        folder: where to begin.
        listing: gets what was not looked at, as it is found. Its ``files`` stay as they are.
    """
    seen: set[str] = set()
    waiting = deque([folder])  # links wait until the folders that are really here were searched

    def unreadable(error: OSError) -> None:
        listing.unreadable[str(error.filename)] = error.strerror or str(error)

    while waiting:
        top = waiting.popleft()
        for where, folders, files in os.walk(top, onerror=unreadable):
            real = os.path.realpath(where)
            if real in seen:
                if where == str(top):
                    listing.left_out["links to folders that were searched already"] += 1
                folders.clear()
                continue
            seen.add(real)
            kept = []
            for name in sorted(folders):
                path = Path(where, name)
                if name.startswith("."):
                    listing.left_out["hidden"] += 1
                elif service := service_folder(path.relative_to(folder)):
                    listing.left_out[f"in {service}, where another program keeps its files"] += sum(
                        len(inside) for _, _, inside in os.walk(path)
                    )
                elif not path.is_symlink():
                    kept.append(name)
                elif Path(os.path.realpath(path)) in (Path(real), *Path(real).parents):
                    listing.left_out["links that lead back up"] += 1
                else:
                    waiting.append(path)
            folders[:] = kept
            if hidden := sum(name.startswith(".") for name in files):
                listing.left_out["hidden"] += hidden
            yield [Path(where, name) for name in sorted(files) if not name.startswith(".")]
    listing.left_out = +listing.left_out  # without zeros


def service_folder(path: PurePath) -> str | None:
    """Return the first folder in a path that is one of ``SERVICE_FOLDERS``, or None.

    Args:
        path: path of a folder, relative to the one that is searched.
    """
    above = ""
    for name in path.parts:
        low = name.lower()
        in_library = above.endswith(_LIBRARIES) and low not in _ORIGINALS
        if in_library or any(fnmatch(low, pattern) for pattern in SERVICE_FOLDERS):
            return name
        above = low
    return None


def check_writable(folder: Path, *, option: str = "") -> None:
    """Write some bytes into a folder, or into that above it where it does not exist yet. They are gone afterwards.

    Args:
        folder: where files are to be written.
        option: the option that named the folder, for the message.

    Raises:
        InputError: nothing can be written there.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    problem = f"{option}: cannot write to {folder}" if option else f"cannot write to {folder}"
    if not existing.is_dir():
        raise InputError(f"{problem}: {existing} is no folder. Choose another folder")
    try:
        with TemporaryFile(dir=existing) as file:
            file.write(bytes(_PROBE))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise InputError(f"{problem} ({error.strerror or error}). Make room there, or choose another folder") from error
