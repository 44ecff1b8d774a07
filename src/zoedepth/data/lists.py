"""Lists of pairs: CSV, JSON Lines, and text lists."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zoedepth.data.facts import DEFAULTS_FILE, Facts, parse_facts
from zoedepth.data.names import Finder
from zoedepth.data.sample import Target
from zoedepth.data.tables import has_header, read_lines, read_table
from zoedepth.data.text_lists import FOCAL, MISSING, read_text_list
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.stored import DEPTH_SUFFIXES, declared_scale, parse_json


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
    camera: Intrinsics | Lens | None = None
    """The camera at the size of the photo; a lens where the list says no more than its focal length."""
    mask: Path | None = None
    """A PNG, not zero where the target is valid."""
    max_depth: float | None = None
    """Depth of this many metres or more is unknown."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the pair."""
        return tuple(path for path in (self.image, self.target, self.mask) if path is not None)


def read_list(path: Path, defaults: Facts, *, root: Path | None = None, anywhere: bool = True) -> list[Pair]:
    """Read the pairs of a list: JSON Lines (.jsonl), a table with names of columns, or a text list without (.txt).

    Args:
        path: the list; see ``zoedepth.data.tables`` and ``zoedepth.data.text_lists`` for the forms that are read.
        defaults: facts for the lines that do not say them.
        root: the folder that its paths are relative to; None takes that of the list.
        anywhere: absolute paths, and those that lead out of the root, are taken, too. A list from elsewhere should not
            reach out of its folder.

    Raises:
        InputError: the list is not text, is empty, or has a malformed line, which is named.
    """
    root = path.parent if root is None else root
    suffix = path.suffix.lower()
    finder = Finder(root, anywhere=anywhere, leading_slash=suffix == ".txt")
    if suffix == ".jsonl":
        rows = _read_jsonl(path)
    elif suffix == ".txt" and not has_header(path):  # spreadsheets write tables as .txt, too
        rows = read_text_list(path, root)
    else:
        rows = read_table(path)
    pairs = [_parse(row, finder, where, defaults) for where, row in rows]
    if not pairs:
        raise InputError(f"{path} lists no pairs")
    return pairs


def check_unit(pair: Pair, defaults: Facts, where: str) -> None:
    """Check that the list, the defaults or the file itself says the unit of a PNG or PGM.

    Raises:
        InputError: none of them does. A file that is missing is no reason.
    """
    if pair.target is None or pair.scale or defaults.depth_scale or pair.target.suffix.lower() not in (".png", ".pgm"):
        return
    if pair.target.is_file() and declared_scale(pair.target) is None:  # a missing file is told elsewhere
        raise InputError(
            f"{where}: nobody says the depth_scale of {pair.target.name}, its stored value of one metre. Give it in "
            f'the list, or for all files by {{"depth_scale": 1000}} in {DEFAULTS_FILE} beside the data'
        )


def _read_jsonl(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (place for messages, the object) of the lines of a list."""
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        row = parse_json(line, where)
        if row.get("depth", "") is None and not row.get("disparity"):
            row["depth"] = MISSING
        yield where, row


def _parse(row: Mapping[str, object], finder: Finder, where: str, defaults: Facts) -> Pair:
    """Make a pair of one line of a list."""
    image, rgb = row.get("image"), row.get("rgb")
    if image and rgb and image != rgb:
        raise InputError(f"{where}: says two photos, image {image!r} and rgb {rgb!r}. Remove one of them")
    image = image or rgb
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
    target = None if row[kind] == MISSING else finder.find(row[kind], where)
    if target is not None and target.suffix.lower() not in DEPTH_SUFFIXES:
        raise InputError(f"{where}: {row[kind]!r} cannot hold {kind}. It must be one of {', '.join(DEPTH_SUFFIXES)}")
    mask = row.get("mask")
    pair = Pair(
        finder.find(image, where),
        target,
        kind,
        said.depth_scale if kind == "depth" else 1.0,
        facts.domain or "",
        facts.camera or _lens(row.get(FOCAL)),
        None if mask in (None, "", MISSING) else finder.find(mask, where),
        facts.max_depth,
    )
    check_unit(pair, defaults, where)
    return pair


def _lens(focal: object) -> Lens | None:
    """Return the lens of a focal length in a text list; None for a number that no lens has, such as 0."""
    try:
        return None if focal is None else Lens(focal_px=float(str(focal)))
    except InputError:
        return None
