"""The inputs of a job, one after the other: files, folders, globs, lists, archives, and the same in stores.

Nothing is listed ahead: an input is there as soon as the folder that it lies in was listed, and memory does not grow
with their number. Only the names of the one folder that is at work are held.
"""

import bz2
import codecs
import csv
import glob
import gzip
import io
import lzma
import os
import posixpath
import re
import tarfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import IO, Any, BinaryIO, cast

from zoedepth.batch import MAX_HELD
from zoedepth.data.names import Finder
from zoedepth.data.tables import SEPARATORS
from zoedepth.errors import OPTIONAL, InputError, MissingExtraError, no_such
from zoedepth.folders import service_folder
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.jobs.names import Names
from zoedepth.jobs.origins import (
    MAX_PHOTO,
    Address,
    Held,
    TarMember,
    ZipMember,
    is_address,
    open_bytes,
    open_store,
    open_zip,
)
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.work import Input
from zoedepth.photos import Found, Origin, left_out, own_name, targets, walk_photos
from zoedepth.stored.tars import MAX_HEADER, open_tar

LISTS = (".txt", ".lst")
"""Suffixes of text files that have a path or an address in each line."""

TABLES = (".csv", ".tsv", ".parquet")
"""Suffixes of tables that have a column of paths or addresses."""

ZIPS = (".zip",)
TARS = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")

COLUMNS = ("image", "photo", "path", "file", "filename", "file_name", "image_path", "url", "uri")
"""Names of the column that is taken where none is said, the first that there is."""

N_FIRST = 64
"""Inputs that are listed before the work begins: to see whether there are any, and which size their photos have."""

_TOGETHER = 1000  # lines and members that get their targets together
_MAX_LINE = 1 << 16  # letters
_MOST_SHOWN = 80  # letters of a line that cannot be a path


@dataclass
class Sources:
    """Everything that a command was given to predict.

    Args:
        names: photos, folders, globs, lists, tables, archives, and addresses of all of them.
        column: the column of tables that has the paths; None: the first of ``COLUMNS`` that there is.
        shard: the part of the inputs that is wanted.

    Raises:
        InputError: photos would be listed among the files that are written.
    """

    names: tuple[str, ...]
    column: str | None = None
    shard: JobShard = field(default_factory=JobShard)
    out: str = ""
    """The address that is written to; nothing below it is an input."""
    found: Found = field(default_factory=Found)
    """The sources that could not be read, and what was left out; complete when all inputs were listed."""
    known: Callable[[str], bool] | None = None
    """A function that returns True for the paths of earlier inputs, such as ``Manifest.knows``.

    These files are not opened to see whether this package wrote them. It may be set while the inputs are listed: it is
    asked from the next folder on."""
    firsts: list[Input] = field(default_factory=list)
    """The first inputs that were listed, of whatever shard, ``N_FIRST`` at most: all shards of a job have the same."""

    def __post_init__(self) -> None:
        written = f"{self.out.rstrip('/')}/"
        for name in self.names:
            if self.out and source_kind(name) == "address" and f"{name.rstrip('/')}/".startswith(written):
                raise InputError(
                    f"{name} lies in --out {self.out}, so that depth maps would be taken for photos when this is typed "
                    "again: write to another prefix"
                )

    @property
    def named(self) -> bool:
        """True if each source is a photo that was named itself: no folder, glob, list or archive."""
        return all(source_kind(name) in ("photo", "address of a photo") for name in self.names)

    def inputs(self) -> Iterator[Input]:
        """Yield the inputs of the shard, each once."""
        self.found = Found()
        return self._inputs(self.found)

    def count(self) -> Iterator[Input]:
        """Yield them as ``inputs`` does, without keeping what could not be read.

        Raises:
            InputError: a tar file is among them, which would be read from its beginning to its end for this.
        """
        if any(source_kind(name) == "tar" for name in self.names):
            raise InputError("the members of a tar file are not counted first")
        # In a thread of its own, which may outlive the manifest that ``known`` asks.
        return replace(self, found=Found(), known=None, firsts=[]).inputs()

    def _inputs(self, found: Found) -> Iterator[Input]:
        seen, taken = Names(), Names()
        kinds = [source_kind(name) for name in self.names]
        several = sum(kind not in ("photo", "address of a photo", "list", "table") for kind in kinds) > 1
        try:
            run: list[str] = []  # files and folders here, which share their rules
            for name, kind in zip(self.names, kinds, strict=True):
                if kind in ("photo", "here"):
                    run.append(name)
                    continue
                yield from self._here(run, found, seen, taken, several=several)
                run = []
                above = _stem(name) if several and kind in ("zip", "tar", "address") else ""
                holds_bytes = kind == "tar" and not name.lower().endswith(".tar")  # it is compressed
                together = 1 if holds_bytes else _TOGETHER
                listed = self._elsewhere(name, kind, found)
                yield from self._placed(listed, seen, taken, above=above, together=together)
            yield from self._here(run, found, seen, taken, several=several)
        finally:
            seen.close()
            taken.close()

    def _here(self, run: list[str], found: Found, seen: Names, taken: Names, *, several: bool) -> Iterator[Input]:
        """Yield photos of files, folders and globs of this machine."""

        def known(path: Path) -> bool:
            return self.known is not None and self.known(os.path.abspath(path))

        groups = [[name] for name in run] if several else [run]
        for group in groups:
            above = None if not several else _stem(group[0]) if os.path.isdir(group[0]) else ""
            photos = walk_photos(group, found, seen=seen, taken=taken, above=above, known=known)
            yield from self._of_shard(
                Input(os.path.abspath(path), place, target, path) for path, place, target in photos
            )

    def _placed(
        self, listed: Iterator["_Listed"], seen: Names, taken: Names, *, above: str, together: int
    ) -> Iterator[Input]:
        """Yield what is listed, each once, with its place and its target."""
        while some := list(islice(listed, together)):
            new = [each for each in some if seen.add(each.name)]
            places = [PurePosixPath(above) / each.place for each in new]
            yield from self._of_shard(
                Input(each.name, place, target, each.path, each.origin, each.size, each.version)
                for each, place, target in zip(new, places, targets(places, taken), strict=True)
            )

    def _of_shard(self, inputs: Iterable[Input]) -> Iterator[Input]:
        """Yield those that belong to the shard, and remember the first of all."""
        for each in inputs:
            # Of an archive whose photos are held themselves, one is enough.
            if len(self.firsts) < N_FIRST and not (self.firsts and isinstance(each.origin, Held)):
                self.firsts.append(each)
            if self.shard.holds(each.place):
                yield each

    def _elsewhere(self, name: str, kind: str, found: Found) -> Iterator["_Listed"]:
        """Yield what a list, a table, an archive or an address has."""
        listers: dict[str, Callable[[], Iterator[_Listed]]] = {
            "list": lambda: _of_lines(name, _lines(name), found),
            "table": lambda: _of_lines(name, _cells(name, self.column), found),
            "zip": lambda: _of_zip(name, found),
            "tar": lambda: _of_tar(name, found),
            "address of a photo": lambda: iter([_of_address(name)]),
            "address": lambda: _of_store(name, self.out, found),
        }
        try:
            yield from listers[kind]()
        except (InputError, MissingExtraError):
            raise
        except Exception as error:  # archives and stores have errors of many kinds
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            found.unreadable[name] = f"cannot be read to its end ({reason})"


def begin(inputs: Iterator[Input], most: int) -> tuple[list[Input], bool]:
    """Take the first inputs, up to ``most``, fewer where the photos themselves are held; return True if it is all."""
    first: list[Input] = []
    n_held = 0
    while len(first) < most and n_held <= MAX_HELD:
        if (each := next(inputs, None)) is None:
            return first, True
        first.append(each)
        n_held += len(each.origin.content) if isinstance(each.origin, Held) else 0
    return first, False


@dataclass(frozen=True)
class _Listed:
    """A photo of a list, an archive or a store."""

    name: str
    place: PurePosixPath
    path: Path
    origin: Origin | None = None
    size: int | None = None
    version: int | str | None = None


def source_kind(name: str) -> str:
    """Return the kind of a source, by what there is on this machine, and then by the name.

    Kinds: photo, here (a folder or a glob of this machine), list, table, zip, tar, address, address of a photo.
    """
    address = is_address(name)
    if not address and os.path.isdir(name):  # unlike Path.is_dir, it raises nothing where nobody may look
        return "here"
    path = name.partition("?")[0].lower() if address else name.lower()
    for kind, suffixes in (("list", LISTS), ("table", TABLES), ("zip", ZIPS), ("tar", TARS)):
        if path.endswith(suffixes) and (address or os.path.isfile(name)):
            return kind
    if not address:
        return "here" if glob.has_magic(name) and not os.path.lexists(name) else "photo"
    is_photo = name.startswith(("http://", "https://")) or PurePosixPath(path).suffix in IMAGE_SUFFIXES
    return "address of a photo" if is_photo and not glob.has_magic(path) else "address"


def _stem(name: str) -> str:
    """Return the name of a folder, an archive or a prefix without its suffixes, for a folder of its own."""
    last = posixpath.basename(name.rstrip("/")) if is_address(name) else own_name(Path(name))
    suffix = next((suffix for suffix in (*ZIPS, *TARS) if last.lower().endswith(suffix)), "")
    return "" if glob.has_magic(last) else last[: len(last) - len(suffix)]


def _plain(path: str) -> PurePosixPath:
    """Return the place in a tree for a path of a list or an archive: without a drive, a root, and steps upwards."""
    parts = PurePosixPath(os.path.normpath(path).replace("\\", "/")).parts
    return PurePosixPath(*(part for part in parts if part not in ("/", "//", "..") and not part.endswith(":")))


def _of_address(address: str, *, whole: bool = False) -> _Listed:
    """Return the photo at an address.

    Args:
        address: the address.
        whole: its place in the tree has the bucket or the host, and the folders.
    """
    origin = Address(address)
    path = origin.name.partition("?")[0].partition("://")[2]
    place = _plain(path)
    return _Listed(origin.name, place if whole else PurePosixPath(place.name), Path(place.name), origin)


def _of_lines(name: str, lines: Iterable[str], found: Found) -> Iterator[_Listed]:
    """Yield the photos of a list. Paths that do not begin at the root are relative to the list's own folder."""
    away = is_address(name)
    folder = name.rpartition("/")[0] if away else os.path.dirname(name)
    finder = Finder(Path(folder), anywhere=True)
    for line in lines:
        if "\0" in line:
            found.unreadable[line.replace("\0", "\\0")[:_MOST_SHOWN]] = (
                f"has a zero byte: is {name} UTF-16 without a mark at its beginning, or damaged?"
            )
            continue
        if line.startswith("#") and not Path(folder, line).exists():  # a comment, as in lists for training
            continue
        if is_address(line):
            yield _of_address(line, whole=True)
        elif away:
            listed = _of_address(f"{folder}/{line}")
            yield _Listed(listed.name, _plain(line), listed.path, listed.origin)
        else:
            try:
                path = finder.find(line, name)
            except InputError as error:
                found.unreadable[line] = str(error)
                continue
            yield _Listed(os.path.abspath(path), _plain(line), path)


def _open_text(name: str) -> io.TextIOWrapper:
    """Open a list or a table in UTF-8, or in UTF-16 with a mark at its beginning, as shells and spreadsheets write it.

    Names of files need not be UTF-8. Their bytes are kept, as Python keeps them in names.
    """
    file = open_bytes(name)
    marked = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    file.seek(0)
    return io.TextIOWrapper(file, "utf-16" if marked else "utf-8-sig", errors="surrogateescape", newline="")


def _lines(name: str) -> Iterator[str]:
    """Yield the lines of a text, without blanks around them and without empty ones."""
    with _open_text(name) as text:
        while line := text.readline(_MAX_LINE):
            if line.strip():
                yield line.strip()


def _cells(name: str, column: str | None) -> Iterator[str]:
    """Yield the cells of a column of a table, without empty ones."""
    if name.lower().endswith(".parquet"):
        try:
            from pyarrow.parquet import ParquetFile
        except ModuleNotFoundError as error:
            raise MissingExtraError(OPTIONAL["pyarrow"], f"{name}, a Parquet file,") from error
        with open_bytes(name) as file:
            table = ParquetFile(file)
            chosen = _column(name, table.schema_arrow.names, column)
            for batch in table.iter_batches(batch_size=_TOGETHER, columns=[chosen]):
                yield from (str(cell) for cell in batch.column(0).to_pylist() if cell)
        return
    with _open_text(name) as text:
        first = text.readline(_MAX_LINE)
        if re.fullmatch(r"sep=.\s*", first):  # Excel's own mark of the separator; the names of the columns say it, too
            first = text.readline(_MAX_LINE)
        separator = _separator(first, column, usual="\t" if name.lower().endswith(".tsv") else ",")
        reader = csv.DictReader(text, next(csv.reader([first], delimiter=separator), ()), delimiter=separator)
        chosen = _column(name, reader.fieldnames or (), column)
        yield from (cell.strip() for row in reader if (cell := row.get(chosen)) and cell.strip())


def _separator(first: str, column: str | None, *, usual: str) -> str:
    """Return the separator with which the first line of a table names a column of photos; the usual one otherwise."""
    for separator in (usual, *SEPARATORS):
        names = next(csv.reader([first], delimiter=separator), ())
        if len(names) > 1 and (column in names if column is not None else _usual_column(names)):
            return separator
    return usual


def _usual_column(names: Iterable[str]) -> str | None:
    """Return the first of ``COLUMNS`` that there is, as it is written there; None where there is none."""
    plain = {name.strip().casefold(): name for name in names}
    return next((plain[known] for known in COLUMNS if known in plain), None)


def _column(name: str, columns: Iterable[str], wanted: str | None) -> str:
    columns = list(columns)
    if photo := next((each for each in columns if PurePosixPath(each.strip()).suffix.lower() in IMAGE_SUFFIXES), None):
        raise InputError(
            f"{name} begins with {photo}, a photo, where the names of its columns belong: give it a first line such as "
            "image, or save it as a .txt with one photo a line"
        )
    if wanted is not None:
        if wanted not in columns:
            raise no_such(f"column in {name}", wanted, columns)
        return wanted
    if chosen := _usual_column(columns) or (columns[0] if len(columns) == 1 else None):
        return chosen
    if not columns:
        raise InputError(f"{name} is empty: it needs a first line with the names of its columns")
    raise InputError(
        f"{name} has the columns {', '.join(columns)}: say which of them has the photos, e.g. --column {columns[0]}"
    )


def _is_photo(member: PurePosixPath, found: Found) -> bool:
    """Return True for a photo among the members of an archive or the objects of a store; others are counted."""
    if any(part.startswith(".") for part in member.parts):
        found.left_out["hidden"] += 1
    elif service := service_folder(member.parent):
        found.left_out[f"in {service}, where another program keeps its files"] += 1
    elif member.suffix.lower() in IMAGE_SUFFIXES:
        return True
    else:
        found.left_out[left_out(member.suffix.lower())] += 1
    return False


def _of_zip(name: str, found: Found) -> Iterator[_Listed]:
    archive = name if is_address(name) else os.path.abspath(name)
    for info in open_zip(archive).infolist():
        place = _plain(info.filename)
        if not info.is_dir() and _is_photo(place, found):
            origin = ZipMember(archive, info.filename)
            yield _Listed(origin.name, place, Path(place), origin, info.file_size, info.CRC)


def _of_tar(name: str, found: Found) -> Iterator[_Listed]:
    archive = name if is_address(name) else os.path.abspath(name)
    plain = name.lower().endswith(".tar")
    with open_bytes(archive) as file, open_tar(unpacked := file if plain else _unpacked(file)) as tar:
        while (member := tar.next()) is not None:
            tar.members = []  # of ten million it would keep each
            place = _plain(member.name)
            is_link = member.islnk() or member.issym()
            if not (member.isreg() or is_link) or not _is_photo(place, found):
                continue
            if is_link:  # to find what it leads to, the places of all members would have to be kept
                found.left_out["links in an archive, which have no bytes of their own: unpack it"] += 1
                continue
            if plain and not member.issparse():
                origin: Origin = TarMember(archive, member.name, member.offset_data, member.size)
            else:
                content = _content(tar, member, unpacked) if member.size <= MAX_PHOTO else b""
                origin = Held(f"{archive}::{member.name}", content)
            yield _Listed(origin.name, place, Path(place), origin, member.size, int(member.mtime))


def _unpacked(file: BinaryIO) -> IO[bytes]:
    """Return what a compressed file holds, by the bytes that it begins with; the file itself where it is another."""
    start = file.read(6)
    file.seek(0)
    if start.startswith(b"\x1f\x8b"):
        return cast("IO[bytes]", gzip.GzipFile(fileobj=file))
    if start.startswith(b"BZh"):
        return bz2.BZ2File(file)
    return lzma.LZMAFile(file) if start == b"\xfd7zXZ\0" else file


def _content(tar: Any, member: tarfile.TarInfo, unpacked: IO[bytes]) -> bytes:
    """Return the bytes of a member; nothing is gone back to, which would unpack all of the file again."""
    if member.issparse():
        opened = tar.extractfile(member)
        return b"".join(iter(lambda: opened.read(MAX_HEADER), b""))
    unpacked.seek(member.offset_data)
    return unpacked.read(member.size)


def _of_store(address: str, out: str, found: Found) -> Iterator[_Listed]:
    """Yield the photos below a prefix of a store, or those that match a glob, folder by folder."""
    fixed = address
    while glob.has_magic(fixed):
        fixed = fixed.rpartition("/")[0]
    store, root = open_store(fixed)
    scheme = address.partition("://")[0]
    pattern = address.partition("://")[2] if fixed != address else ""
    written = open_store(out)[1].rstrip("/") + "/" if out and out.partition("://")[0] == scheme else ""
    n_files = 0
    for folder, folders, files in store.walk(root, detail=True, on_error="raise"):
        if written and f"{folder.rstrip('/')}/".startswith(written):
            folders.clear()
            continue
        for name, info in sorted(files.items()):
            path = str(info["name"])
            if pattern and not _fits(path, pattern):
                continue
            place = _plain(path[len(root) :] if path.startswith(root) else name)
            n_files += 1
            if _is_photo(place, found):
                listed = f"{scheme}://{path.lstrip('/')}" if scheme != "file" else f"file://{path}"
                yield _Listed(listed, place, Path(place), Address(listed), info.get("size"), _version(info))
    if not n_files:
        found.unreadable[address] = "no such file or folder" if not pattern else "matches no file"


def _fits(path: str, pattern: str) -> bool:
    """Return True if a path fits a glob; ** stands for any folders, * for no slash."""
    parts, wanted = path.strip("/").split("/"), pattern.strip("/").split("/")

    def fits(i: int, j: int) -> bool:
        if j == len(wanted):
            return i == len(parts)
        if wanted[j] == "**":
            return any(fits(k, j + 1) for k in range(i, len(parts) + 1))
        return i < len(parts) and fnmatch(parts[i], wanted[j]) and fits(i + 1, j + 1)

    return fits(0, 0)


def _version(info: dict[str, Any]) -> str | None:
    """Return what a store has for the content of an object, or for the time of its last change."""
    for name in ("ETag", "etag", "md5Hash", "LastModified", "updated", "mtime", "created"):
        if info.get(name):
            return str(info[name])
    return None
