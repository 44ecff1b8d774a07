"""The JSON beside the files."""

import json
from pathlib import Path

import numpy as np
import pytest

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.camera_files import read_camera
from zoedepth.outputs import Maps
from zoedepth.outputs.sidecar import describe, of_same_photo, write_sidecar

DEPTH = np.array([[1, 2, 9]], np.float32)


def described(maps: Maps, **facts: object) -> dict[str, object]:
    return describe(maps, origin={"source": "a.jpg"}, facts=facts, files={"depth": "a_depth.png"})


def test_of_metres() -> None:
    assert described(Maps(depth=DEPTH, std=DEPTH), png_scale=256.0) == {
        "source": "a.jpg",
        "unit": "metre",
        "projection": "perspective",
        "depth_along": "optical axis",
        "depth_range": (0.0, None),
        "png_scale": 256.0,
        "depth": {"min": 1.0, "median": 2.0, "max": 9.0},
        "median_confidence": 0.5,
        "files": {"depth": "a_depth.png"},
    }
    assert described(Maps(depth=DEPTH))["median_confidence"] is None


def test_tells_the_camera_to_the_last_bit(tmp_path: Path) -> None:
    camera = Camera((1, 3), 0.1 + 0.2, 1 / 3, 1e-7, 2.0000000000000004, "exif")
    write_sidecar(tmp_path / "a.json", described(Maps(depth=DEPTH, camera=camera)))
    assert json.loads((tmp_path / "a.json").read_text())["camera"] == {
        "size": [1, 3], "fx": 0.1 + 0.2, "fy": 1 / 3, "cx": 1e-7, "cy": 2.0000000000000004, "source": "exif"
    }  # fmt: skip
    assert read_camera(tmp_path / "a.json", (1, 3)) == camera


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


@pytest.mark.parametrize(
    ("written", "photo", "same"),
    [
        ("photos/a.jpg", "photos/a.jpg", True),
        ("photos/a.jpg", "/home/me/photos/a.jpg", True),
        ("/home/me/photos/a.jpg", "a.jpg", True),
        ("photos\\a.jpg", "./photos/a.jpg", True),
        ("left/a.jpg", "right/a.jpg", False),
        ("a.jpg", "a.png", False),
        ("photos/a.jpg", "photos/day/../b.jpg", False),
    ],
)
def test_of_which_photo_it_is(written: str, photo: str, same: bool) -> None:
    assert of_same_photo({"source": written}, Path(photo)) is same
