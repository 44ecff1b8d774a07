"""Lists of pairs: CSV, JSON Lines, and the text lists of BTS."""

import csv
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from zoedepth.data.facts import DEFAULTS_FILE, Facts, parse_facts
from zoedepth.data.sample import Target
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import declared_scale, parse_json

MISSING = "None"
"""The word that stands in a list where a photo has no depth."""

_MAX_LINE = 1 << 20


@dataclass(frozen=True, slots=True)
class Pair:
    """A photo and its depth, in the files that a list or a folder names."""

    image: Path
    target: Path | None
    """None where the list says that there is none."""
    kind: Target
    scale: float | None
    """Depth: the stored value of one metre, None where the list does not say it. Disparity: 1."""
    domain: str
    camera: Intrinsics | None = None
    """The camera at the size of the photo."""
    mask: Path | None = None
    """A PNG, not zero where the target is valid."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the pair."""
        return tuple(path for path in (self.image, self.target, self.mask) if path is not None)


def read_list(path: Path, defaults: Facts) -> list[Pair]:
    """Read the pairs of a list: .jsonl, .txt (BTS), anything else is CSV. Its files are relative to its folder.

    Args:
        path: the list.
        defaults: facts for the lines that do not say them.

    Raises:
        InputError: the list is not text, is empty, or has a malformed line, which is named.
    """
    readers: dict[str, Callable[[Path, Facts], Iterator[Pair]]] = {".jsonl": _read_jsonl, ".txt": _read_bts}
    pairs = list(readers.get(path.suffix.lower(), _read_csv)(path, defaults))
    if not pairs:
        raise InputError(f"{path} lists no pairs")
    return pairs


def check_unit(pair: Pair, defaults: Facts, where: str) -> None:
    """Check that the list, the defaults or the file itself says the unit of a PNG.

    Raises:
        InputError: none of them does.
    """
    if pair.target is None or pair.scale or defaults.depth_scale or pair.target.suffix.lower() != ".png":
        return
    if declared_scale(pair.target) is None:
        raise InputError(
            f"{where}: nobody says the depth_scale of {pair.target.name}, its stored value of one metre. Give it in "
            f'the list, or for all files by {{"depth_scale": 1000}} in {DEFAULTS_FILE} beside the data'
        )


def _read_csv(path: Path, defaults: Facts) -> Iterator[Pair]:
    try:
        reader = csv.DictReader(_lines(path))
        for row in reader:
            yield _parse(row, path, f"{path}, line {reader.line_num}", defaults)
    except csv.Error as error:
        raise InputError(f"{path} is not a CSV file in UTF-8 ({error})") from error


def _read_jsonl(path: Path, defaults: Facts) -> Iterator[Pair]:
    for number, line in enumerate(_lines(path), start=1):
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        row = parse_json(line, where)
        if row.get("depth", "") is None and not row.get("disparity"):
            row["depth"] = MISSING
        yield _parse(row, path, where, defaults)


def _read_bts(path: Path, defaults: Facts) -> Iterator[Pair]:
    """Read lines ``photo depth focal``. A focal length without a principal point is not a camera, and is ignored."""
    for number, line in enumerate(_lines(path), start=1):
        if not (words := line.split()):
            continue
        where = f"{path}, line {number}"
        if len(words) < 2:
            raise InputError(f"{where}: needs a photo and its depth (or {MISSING}); it has only {words[0]!r}")
        # Lists in circulation begin their paths with a slash, and mean a folder of their own all the same.
        row = {"image": words[0].lstrip("/"), "depth": words[1].lstrip("/")}
        yield _parse(row, path, where, defaults)


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file, and refuse one without end."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # -sig: spreadsheets write a mark first
            number = 0
            while line := file.readline(_MAX_LINE):
                number += 1
                if len(line) == _MAX_LINE:
                    raise InputError(f"{path}, line {number}: longer than {_MAX_LINE:,} characters; this is not a list")
                yield line
    except UnicodeDecodeError as error:
        kind = "CSV file" if path.suffix.lower() == ".csv" else "list"
        raise InputError(f"{path} is not a {kind} in UTF-8 ({error}): save it again in UTF-8") from error


def _parse(row: Mapping[str, object], path: Path, where: str, defaults: Facts) -> Pair:
    """Make a pair of one line of a list."""
    image = row.get("image") or row.get("rgb")
    kinds: list[Target] = [kind for kind in ("depth", "disparity") if row.get(kind)]
    if not image:
        raise InputError(f"{where}: has no image. Give the photo's path in the column image")
    if len(kinds) != 1:
        found = "both" if kinds else "neither"
        raise InputError(
            f"{where}: needs one of depth and disparity, and has {found}. For a photo alone write {MISSING}"
        )
    kind = kinds[0]
    said = parse_facts(row, where)
    facts = said.over(defaults)
    if kind == "depth" and not facts.domain:
        raise InputError(f"{where}: needs a domain, for example indoor. Give it in the list or in {DEFAULTS_FILE}")
    mask = row.get("mask")
    pair = Pair(
        _inside(image, path, where),
        None if row[kind] == MISSING else _inside(row[kind], path, where),
        kind,
        said.depth_scale if kind == "depth" else 1.0,
        facts.domain or "",
        facts.camera,
        None if mask in (None, "", MISSING) else _inside(mask, path, where),
    )
    check_unit(pair, defaults, where)
    return pair


def _inside(name: object, path: Path, where: str) -> Path:
    # A list is data from elsewhere: it may not reach out of its folder.
    if not isinstance(name, str) or Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(
            f"{where}: {name!r} must be a path inside the folder of the list, without .. and relative to it"
        )
    return path.parent / name
