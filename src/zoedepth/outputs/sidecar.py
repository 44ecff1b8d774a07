"""The JSON beside the other files of a photo: where they came from, and how to read them."""

import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps
from zoedepth.stored import parse_json, readable, to_json

ENDING = ".json"

MAX_BYTES = 1 << 16
"""The longest sidecar that is read."""


def describe(
    maps: Maps, *, origin: Mapping[str, object], facts: Mapping[str, object], files: Mapping[str, str]
) -> dict[str, object]:
    """Return what there is to say about the files of a photo.

    Args:
        maps: the maps that were written, of depth or of relative depth. Their camera is told to the last bit.
        origin: how they were made: the photo, the model, the sizes, the domain.
        facts: ``Written.facts`` of all files.
        files: name of each file by the name of its output.
    """
    unit = "none: inverse depth up to an unknown scale and shift, near is large" if maps.depth is None else "metre"
    camera = {} if maps.camera is None else {"camera": asdict(maps.camera)}
    measured = {} if maps.depth is None else {
        "projection": maps.projection,
        "depth_along": maps.depth_along,
        "depth_range": tuple(metres if math.isfinite(metres) else None for metres in maps.depth_range),
    }  # fmt: skip
    return {**origin, **camera, "unit": unit, **measured, **facts, **_statistics(maps), "files": dict(files)}


def _statistics(maps: Maps) -> dict[str, object]:
    """Return what sums the depth up; nothing for relative depth, which has no unit."""
    if maps.depth is None:
        return {}
    depth, confidence = maps.depth, maps.confidence
    return {
        "depth": rounded({"min": depth.min(), "median": np.median(depth), "max": depth.max()}),
        "median_confidence": None if confidence is None else round(float(np.median(confidence)), 4),
    }


def write_sidecar(path: Path, values: Mapping[str, object]) -> None:
    """Write a sidecar as JSON, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(to_json(values, indent=2) + "\n", encoding="utf-8")


def read_sidecar(path: Path) -> dict[str, Any] | None:
    """Return the content of a sidecar; None where there is no file, or one that this package did not write."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError:
        return None
    return parse_sidecar(content)


def parse_sidecar(content: bytes) -> dict[str, Any] | None:
    """Return the content of a sidecar; None for a text that this package did not write."""
    try:
        values = parse_json(content, "the sidecar", max_bytes=MAX_BYTES)
    except InputError:
        return None
    files = values.get("files")
    if not isinstance(values.get("zoedepth"), str) or not isinstance(values.get("source"), str):
        return None
    return values if isinstance(files, dict) and all(isinstance(name, str) for name in files.values()) else None


def listed(sidecar: Mapping[str, Any]) -> set[str]:
    """Return the names of the files that a sidecar knows: those it describes, and those of earlier runs."""
    others = sidecar.get("other_files")
    return {*sidecar["files"].values(), *map(str, others if isinstance(others, list) else ())}


def of_same_photo(sidecar: Mapping[str, Any], photo: Path) -> bool:
    """Return False if a sidecar tells of another photo than this one.

    Sidecars keep the path as it was typed, so that "photos/a.jpg" and "/home/me/photos/a.jpg" may be one photo.
    """
    paths = (os.path.normpath(path).replace("\\", "/") for path in (sidecar["source"], readable(str(photo))))
    one, other = (path.split("/")[::-1] for path in paths)
    return all(a == b for a, b in zip(one, other, strict=False))


def rounded(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values with four decimals, as plain floats."""
    return {name: round(float(value), 4) for name, value in values.items()}
