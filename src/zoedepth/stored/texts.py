"""Small texts and JSON: read with bounds on length, depth and value; written so that anything can read them."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoedepth.errors import InputError

MAX_TEXT = 1 << 20
"""Bytes of a small text, at most: 1 MiB."""

MAX_NESTING = 32
"""The greatest depth of brackets in a JSON text."""

_SPELT_OUT = re.compile(rb"\\x([89a-f][0-9a-f])")
_MAX_NUMBER = 1e38  # what float32 holds


def read_text(path: Path, *, max_bytes: int = MAX_TEXT) -> str:
    """Read a text file in UTF-8, with or without a byte order mark.

    Raises:
        InputError: it cannot be read, is not text, or is longer than ``max_bytes``.
    """
    try:
        return _read_small(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text in UTF-8 ({error})") from error


def read_numbers(path: Path) -> list[float]:
    """Read the numbers of a small text file, separated by commas or white space.

    Raises:
        InputError: it cannot be read, is longer than 64 KiB, or has other words.
    """
    text = read_text(path, max_bytes=1 << 16)
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise InputError(f"{path} is not a text file of numbers ({error})") from error


def read_json(path: Path, *, max_bytes: int = MAX_TEXT) -> dict[str, Any]:
    """Read the JSON object in a file: see ``parse_json``.

    Raises:
        InputError: it cannot be read, or is not such an object.
    """
    return parse_json(_read_small(path, max_bytes), str(path), max_bytes=max_bytes)


def parse_json(content: str | bytes, where: str, *, max_bytes: int = MAX_TEXT) -> dict[str, Any]:
    """Return the JSON object that a small text holds, with values that any code can take.

    Args:
        content: the text.
        where: the name of the text for messages.
        max_bytes: the longest text that is parsed.

    Raises:
        InputError: the text is too long, or not a JSON object; it has NaN, Infinity or a number that float32 cannot
            hold, or brackets deeper than ``MAX_NESTING``.
    """
    if len(content) > max_bytes:
        raise InputError(f"{where}: longer than {max_bytes:,} bytes, which is too long for JSON here")
    try:
        value = json.loads(content, parse_constant=_refuse_constant)
        _check_json(value)
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError is a ValueError
        raise InputError(f"{where}: not a JSON object ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{where}: not a JSON object, but a {type(value).__name__}. Write {{...}}")
    return value


def readable(text: str) -> str:
    """Return a text that can be written as UTF-8, which names of files need not be.

    Python keeps the bytes of a name that the system's encoding does not know as lone surrogates, which no file and few
    readers of JSON take. Where these bytes are UTF-8, as under an ASCII locale, they become its letters; others are
    spelt out: ``caf\\xe9.jpg``.
    """
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def unreadable(text: str) -> str:
    """Return the name of a file of which ``readable`` made a text: bytes that it spelt out are those bytes again."""
    spelt = text.encode("utf-8", "surrogateescape")
    return _SPELT_OUT.sub(lambda found: bytes([int(found[1], 16)]), spelt).decode("utf-8", "surrogateescape")


def to_json(values: object, *, indent: int | None = None) -> str:
    """Return values as JSON in ASCII, with every text in it as ``readable`` gives it.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    return json.dumps(_readable(values), indent=indent, allow_nan=False)


def _readable(values: object) -> object:
    if isinstance(values, str):
        return readable(values)
    if isinstance(values, Mapping):
        return {_readable(key): _readable(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_readable(value) for value in values]
    return values


def _read_small(path: Path, max_bytes: int) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror or error}): check the path") from error
    if len(content) > max_bytes:
        raise InputError(f"{path} is longer than {max_bytes:,} bytes: it is not the file that belongs here")
    return content


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a number in JSON")


def _check_json(value: object) -> None:
    level = [value]
    for _ in range(MAX_NESTING):
        inner: list[object] = []
        for item in level:
            if isinstance(item, dict):
                inner.extend(item.values())
            elif isinstance(item, list):
                inner.extend(item)
            elif isinstance(item, int | float) and not abs(item) <= _MAX_NUMBER:
                raise ValueError(f"a number beyond {_MAX_NUMBER:g}")
        level = inner
    if level:
        raise ValueError(f"brackets deeper than {MAX_NESTING}")
