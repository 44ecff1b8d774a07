"""The JSON beside the other files of a photo: where they came from, and how to read them."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps

ENDING = ".json"


def describe(
    maps: Maps, *, origin: Mapping[str, object], facts: Mapping[str, object], files: Mapping[str, str]
) -> dict[str, object]:
    """Return what there is to say about the files of a photo.

    Args:
        maps: the maps that were written, of depth or of relative depth.
        origin: how they were made: the photo, the model, the sizes, the domain.
        facts: ``Written.facts`` of all files.
        files: name of each file by the name of its output.
    """
    unit = "none: inverse depth up to an unknown scale and shift, near is large" if maps.depth is None else "metre"
    return {**origin, "unit": unit, **facts, **_statistics(maps), "files": dict(files)}


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
        temporary.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def rounded(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values with four decimals, as plain floats."""
    return {name: round(float(value), 4) for name, value in values.items()}
