"""Read samples from shards, in any order, with one read each."""

import hashlib
import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import IO
from urllib.parse import quote, urljoin

import numpy as np
from jaxtyping import Int64
from torch.utils.data import Dataset

from zoedepth.data.facts import Facts, asked_over, parse_facts, read_defaults
from zoedepth.data.sample import Sample, Target
from zoedepth.data.targets import to_sample
from zoedepth.download import cache_home, download, sha256_of, version_of
from zoedepth.errors import InputError
from zoedepth.images import read_image_with_orientation
from zoedepth.shards.index import INDEX_FILE, Index, Shard, read_index, scan
from zoedepth.shards.members import MAX_JSON, find_roles, unpack
from zoedepth.stored import Memory, parse_json, read_mask, read_stored

WINDOW = 4
"""The number of shards whose samples a shuffled order mixes."""

_MAX_OPEN = 64


def cache_folder() -> Path:
    """Return the folder where shards from the web are kept."""
    return cache_home() / "zoedepth" / "shards"


def find_shards(folder: Path) -> list[Path]:
    """Find the tar files of a folder, sorted."""
    return sorted(path for path in folder.glob("*.tar") if not path.name.startswith("."))


class ShardDataset(Dataset[Sample]):
    """The samples of shards, by number. It may be copied to any number of worker processes.

    A shard from the web is downloaded whole when its first sample is asked for, and kept, so the disk must have room
    for all of them. An ``index.json`` from the web also says the hash that each shard must have. The server is asked
    every time whether the file at an address is still the same; where it cannot be asked, what is kept is taken.

    Args:
        path: a folder with ``index.json`` or with tar files, an ``index.json``, a .tar, or the address of one of the
            last two. Without an index the headers are read once, which takes a second for some 10,000 samples.
        depth_scale: the stored value of one metre, for samples of which nobody says it.
        domain: scene type, for samples that do not say it.
        max_depth: the metres from which on depth is unknown, for samples that do not say it.
        cache: the folder where shards from the web are kept; None takes ``cache_folder``.

    Raises:
        InputError: there are no shards, or they are unfinished or damaged, or a sample lacks its photo or its depth.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        depth_scale: float | None = None,
        domain: str | None = None,
        max_depth: float | None = None,
        cache: Path | None = None,
    ) -> None:
        self.path = path
        self.folder: Path
        """The folder of the shards; ``dataset.json`` in it says what their samples do not."""
        self._defaults = Facts(depth_scale, domain, max_depth=max_depth)
        self._url: str | None = None
        cache = cache or cache_folder()
        if str(path).startswith(("http://", "https://")):
            self._open_url(str(path), cache)
        else:
            self._open_path(Path(path))
        self.max_depth = self._defaults.max_depth
        """Metres from which on depth is unknown, where this is said for all samples."""
        self._starts = np.cumsum([0, *map(len, self.index.shards)])
        self._files = _Files()

    def _open_path(self, path: Path) -> None:
        self.folder = path if path.is_dir() else path.parent
        self._defaults = asked_over(self._defaults, read_defaults(self.folder), self.folder)
        file = path / INDEX_FILE if path.is_dir() and (path / INDEX_FILE).is_file() else path
        if file.is_dir() or file.suffix == ".tar":
            if not (shards := find_shards(file) if file.is_dir() else [file]):
                raise InputError(f"{path} has no shards: it needs {INDEX_FILE} or .tar files")
            self.index = scan(shards, self._defaults)
            return
        self.index = _usable(read_index(file), file)
        for shard in self.index.shards:
            found = self.folder / shard.name
            if not found.is_file():
                raise InputError(f"{file} lists {shard.name}, which is not beside it: copy it there")
            if found.stat().st_size < shard.offsets[-1]:
                raise InputError(f"{found} is cut short: copy it again")

    def _open_url(self, url: str, cache: Path) -> None:
        if url.endswith(".tar"):
            self.folder = _cached(url, cache)
            self.index = scan([download(url, self.folder / "shard.tar")], self._defaults)
            return
        with tempfile.TemporaryDirectory() as folder:  # asked for anew every time, because the shards may have changed
            file = download(url, Path(folder) / INDEX_FILE)
            self.index = _usable(read_index(file), url)
            content = file.read_bytes()
        self._url = url
        self.folder = cache / hashlib.sha256(content).hexdigest()[:16]

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: int) -> Sample:
        """Read one sample.

        Raises:
            InputError: the shard cannot be fetched, or the sample is damaged; both are named.
        """
        index = range(len(self))[index]
        number = int(np.searchsorted(self._starts, index, side="right")) - 1
        shard, place = self.index.shards[number], index - int(self._starts[number])
        path = self._locate(shard)
        where = f"{path}, sample {place}"
        begin, end = (int(offset) for offset in shard.offsets[place : place + 2])
        block = self._files.read(path, begin, end - begin)
        if len(block) != end - begin:
            raise InputError(f"{where}: the shard is cut short, copy it again")
        members = unpack(block, where)
        roles = find_roles(members, where)
        about = parse_json(members.get("json", b"{}"), where, max_bytes=MAX_JSON)
        facts = parse_facts(about, where)
        name = about.get("name")
        target = _member(members, roles.target, where)
        photo, orientation = read_image_with_orientation(_member(members, roles.photo, where))
        return to_sample(
            photo,
            read_stored(target),
            kind=roles.kind,
            facts=replace(facts.over(self._defaults), depth_scale=facts.depth_scale),
            default_scale=self._defaults.depth_scale,
            mask=None if roles.mask is None else read_mask(_member(members, roles.mask, where)),
            mask_decides=True,
            orientation=orientation,
            name=name if isinstance(name, str) else f"{shard.name}/{place}",
            files=(f"{where}, .{roles.photo}", target),
        )

    def order(self, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
        """Shuffle the numbers of all samples so that reading in this order goes through few shards at a time.

        The shards are shuffled, then the samples of every ``WINDOW`` shards together.
        """
        shards = rng.permutation(len(self.index.shards))
        windows = [shards[first : first + WINDOW] for first in range(0, len(shards), WINDOW)]
        numbers = np.arange(len(self))
        parts = [np.concatenate([numbers[self._starts[i] : self._starts[i + 1]] for i in part]) for part in windows]
        return np.concatenate([rng.permutation(part) for part in parts])

    @property
    def files(self) -> list[Path]:
        """The shards, those from the web where they are kept, whether they are there or not."""
        return [self.folder / shard.name for shard in self.index.shards]

    @property
    def licence(self) -> str | None:
        """The licence of the data that was packed, where it was known."""
        return self.index.licence

    @property
    def domains(self) -> Sequence[str]:
        """The domains that occur."""
        return list(self.index.domains)

    @property
    def kinds(self) -> Sequence[Target]:
        """The kinds of target that occur."""
        return list(self.index.kinds)

    def altered(self) -> dict[int, str]:
        """Return the numbers of the samples in shards that are not as they were written → which one, and what to do.

        Shards without a hash in the index, those of other programs, are not looked at.
        """
        found: dict[int, str] = {}
        for shard, start in zip(self.index.shards, self._starts, strict=False):  # there is one start more
            path = self._locate(shard)
            if shard.sha256 is not None and path.is_file() and sha256_of(path) != shard.sha256:
                problem = f"{path} is damaged, or was changed: it has not the hash that {INDEX_FILE} has. Copy it again"
                found |= dict.fromkeys(range(int(start), int(start) + len(shard)), problem)
        return found

    def _locate(self, shard: Shard) -> Path:
        path = self.folder / shard.name
        if self._url is not None and not path.exists():
            download(urljoin(self._url, quote(shard.name)), path, sha256=shard.sha256)
        return path


class _Files:
    """Files that stay open while pieces of them are read. It may be copied to other processes, which open their own."""

    def __init__(self) -> None:
        self._opened = lru_cache(_MAX_OPEN)(_open)

    def __reduce__(self) -> tuple[type["_Files"], tuple[()]]:
        return type(self), ()  # open files are not sent to other processes

    def read(self, path: Path, offset: int, size: int) -> bytes:
        """Read at most ``size`` bytes from ``offset`` on."""
        try:
            file, lock = self._opened(path, os.getpid())
            with lock:
                file.seek(offset)
                return file.read(size)
        except OSError as error:
            raise InputError(f"cannot read {path} ({error.strerror}): check the path and the disk") from error


def _open(path: Path, process: int) -> tuple[IO[bytes], Lock]:
    """Open a file for one process: a fork shares positions, and its locks may never be released."""
    return path.open("rb"), Lock()


def _cached(url: str, cache: Path) -> Path:
    """Return the folder of a shard without an index: nothing but its address and its server tells it from others.

    Where the server cannot be asked, it is that of the newest one that is kept.
    """
    folder, version = cache / _short_hash(url), version_of(url)
    if version is not None:
        return folder / _short_hash(version)
    kept = sorted(folder.glob("*/shard.tar"), key=lambda path: path.stat().st_mtime)
    return kept[-1].parent if kept else folder / "unknown"


def _short_hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _member(members: dict[str, bytes], extension: str, where: str) -> Memory:
    return Memory(members[extension], f"{where}, .{extension}", f".{extension.rpartition('.')[2]}")


def _usable(index: Index, where: object) -> Index:
    if not index.complete:
        raise InputError(f"{where} is unfinished: type the command `zoedepth data shard` again to finish it")
    if not index.shards:
        raise InputError(f"{where} lists no shards: make them again with `zoedepth data shard`")
    return index
