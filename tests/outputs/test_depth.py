"""16-bit PNGs of metres."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.images import PNG_MAX
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.depth import DEPTH, fitting_scale, write_depth_png
from zoedepth.stored import read_depth


def test_round_trip(tmp_path: Path) -> None:
    depth = np.array([[0.001, 1.2344, 65.535], [2, 3, 9.9999]], np.float32)
    write_depth_png(tmp_path / "folder" / "depth.png", depth)
    np.testing.assert_allclose(read_depth(tmp_path / "folder" / "depth.png"), depth, atol=5.1e-4)
    with Image.open(tmp_path / "folder" / "depth.png") as picture:
        assert picture.mode == "I;16"
        assert picture.text["DepthScale"] == "1000"
        assert picture.text["DepthUnit"] == "metre"


def test_clips_and_never_wraps(tmp_path: Path) -> None:
    depth = np.array([[80, 1e9, 1e-9, 0, -1, np.nan, np.inf, -np.inf]], np.float32)
    write_depth_png(tmp_path / "depth.png", depth)
    with Image.open(tmp_path / "depth.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), [[PNG_MAX, PNG_MAX, 1, 0, 0, 0, 0, 0]])


def test_scale_is_kept_in_the_file(tmp_path: Path) -> None:
    write_depth_png(tmp_path / "depth.png", np.array([[80.0]]), scale=256.0)
    assert read_depth(tmp_path / "depth.png") == 80
    assert read_depth(tmp_path / "depth.png", scale=512.0) == 40
    for scale in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="scale"):
            write_depth_png(tmp_path / "other.png", np.ones((1, 1)), scale=scale)
    assert not (tmp_path / "other.png").exists()


def test_fitting_scale_is_millimetres_up_to_the_last_level() -> None:
    assert fitting_scale(np.array([[65.535]])) == 1000
    assert fitting_scale(np.array([[65.6, np.nan]])) == 256
    assert fitting_scale(np.array([[np.inf]])) == 1000


@pytest.mark.parametrize(
    ("depth", "given", "scale", "note"),
    [(65.0, None, 1000, None), (70.0, None, 256, "256 levels"), (70.0, 1000.0, 1000, "clipped"), (1.0, 5.0, 5, None)],
)
def test_says_its_scale_and_what_the_user_should_know(
    tmp_path: Path, depth: float, given: float | None, scale: float, note: str | None
) -> None:
    maps = Maps(depth=np.full((2, 3), depth, np.float32))
    written = DEPTH.write(tmp_path / "depth.png", maps, Options(png_scale=given))
    assert written.facts == {"png_scale": scale}
    assert [note in said for said in written.notes] == ([] if note is None else [True])


def test_a_depth_map_has_two_dimensions(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="height, width"):
        write_depth_png(tmp_path / "depth.png", np.ones((2, 2, 1)))
    assert not list(tmp_path.iterdir())
