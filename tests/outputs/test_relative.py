"""16-bit PNGs of relative depth."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.relative import RELATIVE, write_relative_png


def test_spans_the_whole_range_and_says_which(tmp_path: Path) -> None:
    relative = np.array([[-2, 0, 1], [4, 8, 2]], np.float32)
    assert write_relative_png(tmp_path / "relative.png", relative) == (-2, 8)
    with Image.open(tmp_path / "relative.png") as picture:
        levels = np.asarray(picture)
        assert (picture.text["RelativeMin"], picture.text["RelativeMax"]) == ("-2", "8")
    assert (levels.min(), levels.max()) == (0, 65535)
    np.testing.assert_allclose(-2 + levels / 65535 * 10, relative, atol=10 / 65535)


def test_one_value_everywhere_is_the_farthest(tmp_path: Path) -> None:
    write_relative_png(tmp_path / "relative.png", np.full((2, 3), 7.0))
    with Image.open(tmp_path / "relative.png") as picture:
        assert not np.asarray(picture).any()


def test_sidecar_gets_the_range(tmp_path: Path) -> None:
    maps = Maps(relative=np.array([[1, 3]], np.float32))
    assert RELATIVE.write(tmp_path / "relative.png", maps, Options()).facts == {"png_range": [1, 3]}


def test_must_be_finite(tmp_path: Path) -> None:
    for value in (np.nan, np.inf):
        with pytest.raises(InputError, match="finite"):
            write_relative_png(tmp_path / "relative.png", np.array([[1, value]]))
    assert not list(tmp_path.iterdir())
