"""The coloured depth alone."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.colors import colorize
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.color import COLOR

RAMP = np.linspace(1, 5, 30 * 50, dtype=np.float32).reshape(30, 50)


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def test_has_the_asked_colours_and_the_photo_s_size(tmp_path: Path) -> None:
    written = COLOR.write(tmp_path / "a.png", Maps(depth=RAMP), Options(vmin=2.0, vmax=3.0, colormap="gray"))
    np.testing.assert_array_equal(pixels(tmp_path / "a.png"), colorize(RAMP, vmin=2.0, vmax=3.0, colormap="gray"))
    assert written.facts == {"color_range": [2, 3], "colormap": "gray"}


def test_says_which_depths_its_colours_are(tmp_path: Path) -> None:
    low, high = COLOR.write(tmp_path / "a.png", Maps(depth=RAMP), Options()).facts["color_range"]
    np.testing.assert_allclose([low, high], np.percentile(RAMP, [1, 99]), atol=1e-4)
    np.testing.assert_array_equal(pixels(tmp_path / "a.png"), colorize(RAMP, vmin=low, vmax=high))


@pytest.mark.parametrize("relative", [RAMP, np.full((3, 4), 7, np.float32)], ids=["ramp", "one value"])
def test_of_relative_depth_has_near_bright(tmp_path: Path, relative: np.ndarray) -> None:
    assert COLOR.write(tmp_path / "a.png", Maps(relative=relative), Options()).facts == {}
    found = pixels(tmp_path / "a.png").astype(int).sum(axis=-1)
    assert found.shape == relative.shape
    assert found[0, 0] < 30  # magma's first colour is nearly black
    if np.ptp(relative):
        assert found[-1, -1] > 600
