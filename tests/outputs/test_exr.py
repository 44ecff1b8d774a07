"""OpenEXR: depth to the last bit, a photo in linear light, and the camera in the header."""

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoedepth.errors import MissingExtraError
from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.exr import EXR, write_exr
from zoedepth.stored import read_depth

OpenEXR = pytest.importorskip("OpenEXR")

SIZE = (3, 4)
DEPTH = np.geomspace(1e-5, 1e3, 12).astype(np.float32).reshape(SIZE)
IMAGE = np.arange(36, dtype=np.uint8).reshape(*SIZE, 3) * 7
CAMERA = Camera(SIZE, 5.25, 5.5, 1.0 / 3, 2.0, "exif")


def read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return dict(file.header()), {name: channel.pixels for name, channel in file.channels().items()}


def test_has_depth_and_the_photo_as_other_programs_show_it(tmp_path: Path) -> None:
    EXR.write(tmp_path / "a.exr", Maps(depth=DEPTH, image=IMAGE), Options())
    _, channels = read(tmp_path / "a.exr")
    assert set(channels) == {"Z", "R", "G", "B"}
    assert channels["Z"].dtype == np.float32
    np.testing.assert_array_equal(channels["Z"], DEPTH)
    light = np.stack([channels[name] for name in "RGB"], axis=-1).astype(np.float64)
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)  # the curve of a screen
    np.testing.assert_array_equal((shown * 255).round(), IMAGE)


def test_depth_alone_is_the_only_channel_and_what_is_not_known_is_0(tmp_path: Path) -> None:
    write_exr(tmp_path / "folder" / "a.exr", np.array([[1.5, np.nan, -1, np.inf, 0]], np.float32))
    header, channels = read(tmp_path / "folder" / "a.exr")
    assert set(channels) == {"Z"}
    assert channels["Z"].tolist() == [[1.5, 0, 0, 0, 0]]
    assert "intrinsics" not in header


def test_header_has_the_camera(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", DEPTH, camera=CAMERA)
    header, _ = read(tmp_path / "a.exr")
    np.testing.assert_array_equal(header["intrinsics"], CAMERA.matrix)
    assert header["cameraSource"] == "exif"
    assert "metres" in header["comments"]
    # The standard's screen window lies at 1 m, in axes with x to the left and y up.
    left, top = CAMERA.ray(-0.5, -0.5)[:2]
    right, bottom = CAMERA.ray(3.5, 2.5)[:2]
    assert header["screenWindowWidth"] == pytest.approx(right - left)
    np.testing.assert_allclose(header["screenWindowCenter"], [-(left + right) / 2, -(top + bottom) / 2], rtol=1e-6)


def test_flat_pictures_are_not_packed_so_that_they_look_like_bombs(tmp_path: Path) -> None:
    depth, image = np.full((2600, 2600), 2, np.float32), np.full((2600, 2600, 3), 255, np.uint8)
    write_exr(tmp_path / "a.exr", depth, image=image)
    np.testing.assert_array_equal(read_depth(tmp_path / "a.exr"), depth)
    assert (tmp_path / "a.exr").stat().st_size > depth.nbytes
    write_exr(tmp_path / "a.exr", depth)
    assert (tmp_path / "a.exr").stat().st_size < depth.nbytes / 100


def test_extra_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "OpenEXR":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingExtraError, match=r"writing an \.exr needs the extra \[exr\]"):
        write_exr(tmp_path / "a.exr", DEPTH)
    assert list(tmp_path.iterdir()) == []
