"""The photos that files, folders and globs name: each once, each with a place for its files that no other has.

Jobs, ``zoedepth predict`` and ``predict_all`` take them from here.

    for photo in find_photos(["photos/"], Path("depth")).photos:
        print(photo.path, photo.file("_depth.png"))
"""

import glob
import os
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import cache
from itertools import chain, count
from pathlib import Path, PurePosixPath
from typing import Protocol

from zoedepth.folders import Listing, service_folder, walk_files
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.outputs.ownership import is_own_file

_OTHER_PICTURES = {
    suffix: advice
    for advice, suffixes in (
        ("which phones write: pip install 'zoedepth[heic]', or save them as JPEG", ".heic .heif .hif .heics"),
        ("which are raw: develop them to JPEG or TIFF, e.g. with darktable",
         ".dng .cr2 .cr3 .crw .nef .nrw .arw .sr2 .raf .orf .rw2 .pef .srw .raw .rwl .3fr .iiq .x3f .gpr"),
        ("which are JPEG XL: save them as JPEG", ".jxl"),
        ("which are films: take pictures out of them first, e.g. ffmpeg -i FILM frames/%05d.png",
         ".mp4 .mov .avi .mkv .m4v .mts .m2ts .webm .insv .insp .360"),
        ("which are documents: save their pictures as JPEG or PNG", ".psd .pdf .svg .xcf .ai"),
        ("which have a wide range of light: save them as JPEG or PNG", ".exr .hdr .pfm"),
        ("which are archives: name a .zip or .tar itself, or unpack it", ".zip .tar .tgz"),
        ("which are archives: unpack them first", ".gz .7z .rar"),
    )
    for suffix in suffixes.split()
}  # fmt: skip
"""Suffix (lower case) of files that somebody may take for photos → what they are, and what to do."""


class Origin(Protocol):
    """The place of a photo that is no file here: a member of an archive, an object of a store."""

    @property
    def name(self) -> str:
        """The name of the photo, for people and for its sidecar."""
        ...

    def read(self) -> bytes:
        """Return the photo's bytes.

        Raises:
            InputError: they cannot be read.
        """
        ...


@dataclass(frozen=True)
class Photo:
    """A photo to predict, and where its files go."""

    path: Path
    target: Path
    """The path of its files without their endings: <out>/<folder>/<name>."""
    origin: Origin | None = None
    """Its place, if it is no file at ``path``."""

    @property
    def name(self) -> str:
        """The path as it was given, or the name that its origin has for it."""
        return str(self.path) if self.origin is None else self.origin.name

    def file(self, ending: str) -> Path:
        """Return the path of the file with this ending, e.g. "_depth.png"."""
        return self.target.with_name(self.target.name + ending)


@dataclass
class Found:
    """The photos that the sources named, and what else was there."""

    photos: list[Photo] = field(default_factory=list)
    unreadable: dict[str, str] = field(default_factory=dict)
    """Source or folder that could not be read → why."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Reason why files of folders and globs were left out, e.g. "hidden" → how many."""

    @property
    def failures(self) -> list[str]:
        """One message for each source or folder that could not be read."""
        return [f"{path}: {reason}" for path, reason in self.unreadable.items()]

    @property
    def n_ignored(self) -> int:
        """Everything that was left out of folders and globs."""
        return self.left_out.total()


def find_photos(sources: Iterable[str], out: Path) -> Found:
    """Find the photos named by files, folders and globs: each once, each with files of its own.

    A photo's files are <out>/<its folder below the source>/<stem>. With several folders each keeps its own name in the
    tree. Photos that would share files (a.jpg and a.png) take their whole name (a.jpg, a.png), then a number.

    Links to folders are followed (see ``folders.list_files``). Files that this package wrote are no photos, wherever
    they lie, and neither are the thumbnails that other programs keep. A file that is named itself is always tried.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg").
        out: the folder that the files go to. It need not exist.
    """
    found = Found()
    for path, _, target in walk_photos(sources, found, seen=NamesInMemory(), taken=NamesInMemory()):
        found.photos.append(Photo(path, out / target))
    return found


class Names(Protocol):
    """A set of names that remembers what was added."""

    def add(self, name: str) -> bool:
        """Add a name; returns True if it was not there before."""
        ...

    def add_all(self, names: Sequence[str]) -> bool:
        """Add names if none of them was there before and no two are equal; otherwise add none, and return False."""
        ...


class NamesInMemory:
    """A set of names in memory."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def add(self, name: str) -> bool:
        """See ``Names``."""
        before = len(self._names)
        self._names.add(name)
        return len(self._names) > before

    def add_all(self, names: Sequence[str]) -> bool:
        """See ``Names``."""
        new = set(names)
        if len(new) < len(names) or not new.isdisjoint(self._names):
            return False
        self._names |= new
        return True


def walk_photos(
    sources: Iterable[str],
    found: Found,
    *,
    seen: Names,
    taken: Names,
    above: str | None = None,
    known: Callable[[Path], bool] = lambda _: False,
) -> Iterator[tuple[Path, PurePosixPath, PurePosixPath]]:
    """Find photos as ``find_photos`` does, and yield each as soon as the folder that it lies in was listed.

    Args:
        sources: photos, folders and globs.
        found: gets what cannot be read, and what is left out, as it is found. Its ``photos`` stay as they are.
        seen: the photos that were found before; they are not yielded again.
        taken: the targets that photos have.
        above: name of a folder that all photos of folders are put in; None: the folder's own, where there are several.
        known: returns True for photos that were found before: whether this package wrote them is not looked at again.

    Yields:
        The path, its place in the tree of all photos, and its target, the place that its files take without an ending.
    """
    sources = list(sources)
    several_folders = sum(map(os.path.isdir, sources)) > 1
    named: list[tuple[Path, PurePosixPath]] = []
    for source in sources:
        path = Path(source)
        if not os.path.isdir(path) and os.path.lexists(path):
            named.append((path, PurePosixPath(path.name)))  # named one by one: tried whatever its suffix
            continue
        yield from _new(named, seen, taken)
        named = []
        listing = Listing()
        if os.path.isdir(path):
            root = path
            place = above if above is not None else own_name(path) if several_folders else ""
            folders = walk_files(path, listing)
        elif glob.has_magic(source):
            root, place = _fixed_part(source), above or ""
            folders = _matching(source, root, listing)
        else:
            found.unreadable[source] = "no such file or folder"
            continue
        n_files = 0
        for files in folders:
            n_files += len(files)
            # They are of one folder.
            below = PurePosixPath(place, files[0].parent.relative_to(root).as_posix() if files else "")
            yield from _new([(file, below / file.name) for file in _photos(files, found, known)], seen, taken)
        if not n_files and not os.path.isdir(path):
            found.unreadable[source] = "matches no file"
        found.unreadable.update(listing.unreadable)
        found.left_out.update(listing.left_out)
    yield from _new(named, seen, taken)


def own_name(path: Path) -> str:
    """Return the last part of a path as it was typed, since a link's target may be called otherwise on each machine.

    Of ``.`` and ``..`` it is the name of the folder that they stand for.
    """
    return path.resolve().name if path.name in ("", "..") else path.name


def _photos(files: Iterable[Path], found: Found, known: Callable[[Path], bool]) -> Iterator[Path]:
    """Yield the photos among the files of folders, and keep what else was there."""
    for file in files:
        suffix = file.suffix.lower()
        if suffix in IMAGE_SUFFIXES and known(file):
            yield file
        elif reason := _no_photo(file, suffix):
            found.left_out[reason] += 1
        elif suffix in IMAGE_SUFFIXES:
            yield file
        else:
            found.unreadable[str(file)] = "the link leads nowhere: is the disk there?"


def _new(
    photos: Iterable[tuple[Path, PurePosixPath]], seen: Names, taken: Names
) -> Iterator[tuple[Path, PurePosixPath, PurePosixPath]]:
    """Yield those photos that were not seen before, each with a target that no other has.

    Args:
        photos: paths, and their places in the tree; photos that are found together, such as those of one folder.
        seen: see ``walk_photos``.
        taken: see ``walk_photos``.
    """
    real_folder = cache(os.path.realpath)
    new = list(photos)
    names = [os.path.join(real_folder(folder), name) for folder, name in (os.path.split(path) for path, _ in new)]
    if not seen.add_all(names):
        new = [photo for photo, name in zip(new, names, strict=True) if seen.add(name)]
    yield from (
        (path, place, target)
        for (path, place), target in zip(new, targets([place for _, place in new], taken), strict=True)
    )


def targets(places: Sequence[PurePosixPath], taken: Names) -> Iterator[PurePosixPath]:
    """Yield for each place in a tree a target: the path of its files without their endings, which no other has.

    Args:
        places: places of photos that are found together.
        taken: the targets that others have.
    """

    def key(place: PurePosixPath) -> str:
        # a.jpg and A.png share their files on Windows and macOS, and so do two ways to write é on macOS.
        name = str(place)
        if name.isascii():  # there is nothing to normalise
            return name.lower()
        return unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())

    stems = [place.with_suffix("") for place in places]
    keys = [key(stem) for stem in stems]
    if taken.add_all(keys):
        yield from stems
        return
    n_sharing = Counter(keys)
    for place, stem, key_of_stem in zip(places, stems, keys, strict=True):
        if n_sharing[key_of_stem] == 1 and taken.add(key_of_stem):
            yield stem
            continue
        numbered = (place.with_name(f"{place.name}-{number}") for number in count(2))
        yield next(name for name in chain((place,), numbered) if taken.add(key(name)))


def _no_photo(file: Path, suffix: str) -> str | None:
    """Return why a file in a folder is no photo; None for a photo, and for a link without a suffix that leads nowhere.

    Args:
        file: the file.
        suffix: its suffix, lower case.
    """
    if (suffix in IMAGE_SUFFIXES or suffix in _OTHER_PICTURES) and is_own_file(file):
        return "written by zoedepth"
    if suffix in IMAGE_SUFFIXES:  # whoever opened a pipe would wait for ever
        there = os.path.exists(file)  # unlike Path.exists, it raises nothing where nobody may look
        return None if os.path.isfile(file) or not there else "pipes and devices, which are no files"
    return left_out(suffix) if suffix or not os.path.islink(file) or os.path.exists(file) else None


def left_out(suffix: str) -> str:
    """Return why files with a suffix (lower case) are no photos, with advice where there is some."""
    if suffix in _OTHER_PICTURES:
        return f"{suffix} files, {_OTHER_PICTURES[suffix]}"
    return "files of other kinds"


def _fixed_part(pattern: str) -> Path:
    """Return the folders of a glob before its first wildcard."""
    parts = Path(pattern).parts
    n_fixed = next(i for i, part in enumerate(parts) if glob.has_magic(part))
    return Path(*parts[:n_fixed])


def _matching(pattern: str, root: Path, listing: Listing) -> Iterator[list[Path]]:
    """Yield the files that match a glob, folder by folder, without those in the folders of other programs.

    Python's own glob goes round in circles where links do.
    """
    parts = Path(pattern).parts[len(root.parts) :]
    if "**" in parts:
        for files in walk_files(root, listing):
            yield [file for file in files if _fits(file.relative_to(root).parts, parts)]
        return
    for files in _level_by_level(root, parts):
        kept = []
        for file in files:
            if service := service_folder(file.relative_to(root).parent):
                listing.left_out[f"in {service}, where another program keeps its files"] += 1
            elif not os.path.isdir(file):
                kept.append(file)
        yield kept


def _level_by_level(folder: Path, parts: tuple[str, ...]) -> Iterator[list[Path]]:
    """Yield what matches the parts of a glob below a folder, folder by folder, as Python's own glob finds it."""
    name, *rest = parts
    if glob.has_magic(name):
        try:
            there = sorted(entry for entry in os.listdir(folder) if name.startswith(".") or not entry.startswith("."))
        except OSError:  # no folder, or one that may not be read, has nothing that matches
            return
        found = [folder / entry for entry in there if fnmatch(entry, name)]
    else:
        found = [folder / name] if os.path.lexists(folder / name) else []
    if not rest:
        yield found
        return
    for path in found:
        yield from _level_by_level(path, tuple(rest))


def _fits(names: tuple[str, ...], parts: tuple[str, ...]) -> bool:
    """Return True if the parts of a path fit those of a glob; ** stands for any number of folders."""
    if not parts:
        return not names
    if parts[0] == "**":
        return any(_fits(names[n:], parts[1:]) for n in range(len(names) + 1))
    return bool(names) and fnmatch(names[0], parts[0]) and _fits(names[1:], parts[1:])
