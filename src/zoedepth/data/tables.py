"""Tables of pairs as programs and spreadsheets write them: with any usual separator, and in UTF-8 or UTF-16."""

import codecs
import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from zoedepth.errors import InputError

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
"""Characters that may separate the columns → what they are called."""

PHOTOS, TARGETS = ("image", "rgb"), ("depth", "disparity")
"""Names of the columns that a table must have, one of each."""

_NUMBERS = ("depth_scale", "max_depth", "fx", "fy", "cx", "cy")
_MAX_LINE = 1 << 20
# Spreadsheets write 1000 as 1,000 or 1.000 in some countries, and in others these are 1.
_THOUSANDS = re.compile(r"[1-9]\d{0,2}[.,]\d{3}")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")


@dataclass(frozen=True)
class Header:
    """The columns of a table."""

    separator: str
    names: tuple[str, ...]
    """In lower case, with _ for blanks; "" for a column without a name."""


def read_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text in UTF-8, or in UTF-16 with a mark at its beginning; refuse one without end."""
    try:
        with path.open("rb") as file:
            marked = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        # Spreadsheets write "Unicode text" in UTF-16, and a mark before UTF-8, which -sig takes away.
        with path.open(newline="", encoding="utf-16" if marked else "utf-8-sig") as file:
            number = 0
            while line := file.readline(_MAX_LINE):
                number += 1
                if len(line) == _MAX_LINE:
                    raise InputError(f"{path}, line {number}: longer than {_MAX_LINE:,} characters; this is not a list")
                yield line
    except UnicodeError as error:
        kind = "CSV file" if path.suffix.lower() == ".csv" else "list"
        raise InputError(f"{path} is not a {kind} in UTF-8 ({error}): save it again in UTF-8") from error


def find_header(line: str) -> Header | None:
    """Return the columns that a line names; None where it does not name those of a photo and of its depth."""
    for separator in SEPARATORS:
        names = tuple(cell.casefold().replace(" ", "_").replace("-", "_") for cell in _split(line, separator))
        if set(PHOTOS) & set(names) and set(TARGETS) & set(names):
            return Header(separator, names)
    return None


def has_header(path: Path) -> bool:
    """Return True if a text begins with the names of columns."""
    return _begin(read_lines(path))[1] is not None


def read_table(path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield (place for messages, column → value) of the rows of a table.

    The separator is the one with which the first line names the columns. Capitals and blanks around names and values do
    not count, and rows without any value are left out. Numbers may have a decimal comma.

    Raises:
        InputError: the file is no text, its first line names no columns, or a row has too many values or an ambiguous
            number; the line is named.
    """
    lines = read_lines(path)
    first, header, number = _begin(lines)
    if not first:
        return
    if header is None:
        shown = first.strip() if len(first) <= 80 else f"{first[:80]}…"
        raise InputError(
            f"{path}, line {number}: the first line must name the columns image and depth (or disparity), separated by "
            f"commas, semicolons or tabs; it is {shown!r}"
        )
    for name in {*PHOTOS, *TARGETS, *_NUMBERS, "domain", "mask"}:
        if header.names.count(name) > 1:
            raise InputError(f"{path}, line {number}: has two columns {name}. Remove one of them")
    reader = csv.reader(lines, delimiter=header.separator, skipinitialspace=True, strict=True)
    n_named = max(place for place, name in enumerate(header.names, start=1) if name)
    try:
        for cells in reader:
            where = f"{path}, line {number + reader.line_num}"
            cells = [cell.strip() for cell in cells]
            if not any(cells):
                continue
            if extra := next(filter(None, cells[n_named:]), None):
                raise InputError(
                    f"{where}: has {extra!r} behind its last column, which is {header.names[n_named - 1]}. Put values "
                    f"that have {SEPARATORS[header.separator]} in them between quotation marks"
                )
            row = {name: cell for name, cell in zip(header.names, cells, strict=False) if name}
            for name in row.keys() & set(_NUMBERS):
                row[name] = _point(row[name], name, header.separator, where)
            yield where, row
    except csv.Error as error:
        where = f"{path}, line {number + reader.line_num}"
        raise InputError(f"{where}: not CSV, check its quotation marks ({error})") from error


def _begin(lines: Iterator[str]) -> tuple[str, Header | None, int]:
    """Return (first line, the columns it names, its number); "" where there is none. Leaves the rest of the lines."""
    for number, line in enumerate(lines, start=1):
        # Excel's own mark of the separator; the header says it, too.
        if line.strip() and not re.fullmatch(r"sep=.\s*", line):
            return line, find_header(line), number
    return "", None, 0


def _split(line: str, separator: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return []


def _point(text: str, name: str, separator: str, where: str) -> str:
    """Return a number with a point for a decimal comma; refuse one that is 1000 in some countries and 1 in others."""
    if _THOUSANDS.fullmatch(text):
        # Where commas separate the columns a point is decimal, and where semicolons do, a comma. No camera has a focal
        # length of 518.858 thousand pixels.
        camera = name in ("fx", "fy", "cx", "cy")
        clear = (camera and separator == ";") if "," in text else (camera or separator == ",")
        if not clear:
            plain = re.sub("[.,]", "", text)
            raise InputError(
                f"{where}: {name} {text!r} is {plain} in some countries and {float(text.replace(',', '.')):g} in "
                f"others. Write {plain}, or the other with another number of digits"
            )
    return text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text
