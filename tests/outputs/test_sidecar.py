"""The JSON beside the files."""

import json
from pathlib import Path

import numpy as np
import pytest

from zoedepth.outputs import Maps
from zoedepth.outputs.sidecar import describe, write_sidecar

DEPTH = np.array([[1, 2, 9]], np.float32)


def described(maps: Maps, **facts: object) -> dict[str, object]:
    return describe(maps, origin={"source": "a.jpg"}, facts=facts, files={"depth": "a_depth.png"})


def test_of_metres() -> None:
    assert described(Maps(depth=DEPTH, std=DEPTH), png_scale=256.0) == {
        "source": "a.jpg",
        "unit": "metre",
        "png_scale": 256.0,
        "depth": {"min": 1.0, "median": 2.0, "max": 9.0},
        "median_confidence": 0.5,
        "files": {"depth": "a_depth.png"},
    }
    assert described(Maps(depth=DEPTH))["median_confidence"] is None


def test_of_relative_depth_has_no_metres() -> None:
    values = described(Maps(relative=DEPTH), png_range=[1, 9])
    assert values.keys() == {"source", "unit", "png_range", "files"}
    assert "none" in str(values["unit"])


def test_is_written_as_json_or_not_at_all(tmp_path: Path) -> None:
    write_sidecar(tmp_path / "out" / "a.json", described(Maps(depth=DEPTH)))
    assert json.loads((tmp_path / "out" / "a.json").read_text())["depth"]["max"] == 9
    with pytest.raises(ValueError, match="JSON"):
        write_sidecar(tmp_path / "b.json", {"median": float("nan")})
    assert not (tmp_path / "b.json").exists()
