"""The index of shards: where each sample begins, from ``index.json`` or by reading the headers once."""

import json
import re
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

from zoedepth.data.facts import Facts, parse_facts
from zoedepth.data.names import composed
from zoedepth.data.sample import Target
from zoedepth.errors import InputError
from zoedepth.shards.members import MAX_JSON, MAX_SAMPLE, find_roles, split_name
from zoedepth.stored import parse_json
from zoedepth.stored.tars import check_end, open_tar

INDEX_FILE = "index.json"

_FORMAT = "zoedepth shards 1"
# A million samples in a thousand shards take 12 MB: a number for each sample, two brackets and eight texts for each
# shard.
_MAX_INDEX, _MOST = 1 << 25, {b",": 2_000_000, b"[": 100_000, b"{": 100_000, b'"': 1_600_000}
_SHARD_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,200}\.tar")


@dataclass(frozen=True)
class Shard:
    """One tar file."""

    name: str
    """Name of the file in the folder of the index."""
    offsets: Int64[np.ndarray, " samples+1"]
    """The byte at which each sample begins; the last number is where the last sample ends."""
    sha256: str | None = None
    """SHA-256 of the whole file, where it is known."""
    state: str | None = None
    """Hash that changes with the size or the time of any file that was packed; None where that is not known."""

    def __len__(self) -> int:
        return len(self.offsets) - 1


@dataclass(frozen=True)
class Index:
    """The facts about shards that are known without opening them."""

    shards: Sequence[Shard]
    domains: Sequence[str]
    kinds: Sequence[Target]
    complete: bool = True
    """True if all shards are written."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """The writer's settings, which must be the same to go on after an interruption."""
    licence: str | None = None
    """The licence of the data, where it is known."""
    skipped: tuple[int, ...] = ()
    """Numbers, in the data that was packed, of the samples that could not be read and are in no shard."""

    def to_json(self) -> str:
        """Return the text of ``index.json``."""
        shards = [
            {
                "name": shard.name,
                "samples": len(shard),
                "sha256": shard.sha256,
                **({"state": shard.state} if shard.state else {}),
                "offsets": shard.offsets.tolist(),
            }
            for shard in self.shards
        ]
        record = {
            "format": _FORMAT,
            "complete": self.complete,
            "samples": sum(map(len, self.shards)),
            "domains": list(self.domains),
            "kinds": list(self.kinds),
            "settings": dict(self.settings),
            **({"licence": self.licence} if self.licence else {}),
            **({"skipped": list(self.skipped)} if self.skipped else {}),
            "shards": shards,
        }
        return json.dumps(record, separators=(",", ":"))

    @classmethod
    def from_json(cls, content: bytes, where: str) -> "Index":
        """Make an index of the text that ``to_json`` returned.

        Raises:
            InputError: the text is not an index, or contradicts itself.
        """
        for sign, most in _MOST.items():  # a bracket of two bytes is a list of sixty
            if content.count(sign) > most:
                raise InputError(
                    f"{where} is no index of shards, or one of more than two million samples: it has more than "
                    f"{most:,} {sign.decode()}. Spread the shards over several folders"
                )
        record = parse_json(content, where, max_bytes=_MAX_INDEX)
        if record.get("format") != _FORMAT:
            raise InputError(f"{where} is no index of shards: its format is {record.get('format')!r}, not {_FORMAT!r}")
        try:
            shards = [_parse_shard(entry) for entry in record["shards"]]
            domains = [str(name) for name in record["domains"]]
            kinds: list[Target] = [kind for kind in ("depth", "disparity") if kind in record["kinds"]]
            licence = record.get("licence")
            skipped = tuple(int(number) for number in record.get("skipped", ()))
            return cls(
                shards, domains, kinds, record["complete"] is True, dict(record["settings"]),
                licence if isinstance(licence, str) else None, skipped,
            )  # fmt: skip
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise InputError(f"{where} is damaged, copy it again ({error!r})") from error


def read_index(path: Path) -> Index:
    """Read the index in a file.

    Raises:
        InputError: the file cannot be read, or is damaged.
    """
    try:
        with path.open("rb") as file:
            return Index.from_json(file.read(_MAX_INDEX + 1), str(path))
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from error


def scan(paths: Sequence[Path], defaults: Facts) -> Index:
    """Make the index of shards that anybody wrote, from their headers and the JSON of each sample.

    Args:
        paths: tar files, not compressed.
        defaults: facts for the samples that do not say them.

    Raises:
        InputError: a file is damaged or no tar file, or a sample has no photo, depth or domain.
    """
    shards: list[Shard] = []
    domains: set[str] = set()
    kinds: set[Target] = set()
    for path in paths:
        groups = list(_groups(path))
        if not groups:
            raise InputError(f"{path} has no samples: name the members KEY.jpg, KEY.depth.png, KEY.json")
        for group in groups:
            where = f"{path}, sample {group.key!r}"
            kind = find_roles(group.extensions, where).kind
            facts = parse_facts(parse_json(group.json, where, max_bytes=MAX_JSON), where).over(defaults)
            if kind == "depth" and not facts.domain:
                raise InputError(f'{where}: needs a domain: {{"domain": "indoor"}} in its .json, or one given for all')
            if group.end - group.start > MAX_SAMPLE:
                raise InputError(f"{where}: larger than {MAX_SAMPLE:,} bytes, the most that a sample may have")
            domains.add(facts.domain or "")
            kinds.add(kind)
        offsets = [group.start for group in groups] + [groups[-1].end]
        shards.append(Shard(path.name, np.array(offsets, np.int64)))
    return Index(shards, sorted(domains), sorted(kinds))


@dataclass
class _Group:
    """Consecutive members with one key."""

    key: str
    start: int
    end: int
    extensions: set[str]
    json: bytes = b"{}"


def _groups(path: Path) -> Iterator[_Group]:
    group = None
    try:
        with path.open("rb") as file, open_tar(file) as archive:
            while (member := archive.next()) is not None:
                archive.members = []  # it would keep them all
                name = split_name(member.name) if member.isreg() and not member.issparse() else None
                if name is None:
                    continue
                key = composed(name[0])
                if group is None or group.key != key:
                    if group is not None:
                        yield group
                    group = _Group(key, member.offset, 0, set())
                group.extensions.add(name[1])
                group.end = member.offset_data + -(-member.size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE
                if name[1] == "json":
                    file.seek(member.offset_data)
                    group.json = file.read(min(member.size, MAX_JSON + 1))
            check_end(file, archive.offset)
    except (OSError, tarfile.TarError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path} is compressed, damaged, or not a tar file at all ({error}). Unpack or copy it again"
        ) from error
    if group is not None:
        yield group


def _parse_shard(entry: dict[str, Any]) -> Shard:
    name, sha256 = entry["name"], entry["sha256"]
    # The name becomes a path.
    if not _SHARD_NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no name of a shard")
    if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
        raise ValueError(f"{sha256!r} is no SHA-256")
    offsets = np.array(entry["offsets"], np.int64)
    sizes = np.diff(offsets)
    if offsets.ndim != 1 or len(sizes) == 0 or offsets[0] < 0 or sizes.min() <= 0 or sizes.max() > MAX_SAMPLE:
        raise ValueError(f"the offsets of {name} are not those of samples")
    state = entry.get("state")
    return Shard(name, offsets, sha256, state if isinstance(state, str) else None)
