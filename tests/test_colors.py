"""Depth as a picture."""

import numpy as np
import pytest

from zoedepth.colors import COLORMAPS, INVALID_COLOR, color_bar, colorize, depth_range, panel, preview, sheet
from zoedepth.errors import InputError

RAMP = np.linspace(1, 5, 256, dtype=np.float32)[None]


@pytest.mark.parametrize("name", COLORMAPS)
def test_tables_are_256_colours_and_reverse(name: str) -> None:
    colors = colorize(RAMP, vmin=1.0, vmax=5.0, colormap=name)
    assert colors.shape == (1, 256, 3)
    assert len(np.unique(colors[0], axis=0)) > 200
    np.testing.assert_array_equal(colorize(RAMP, vmin=1.0, vmax=5.0, colormap=f"{name}_r"), colors[:, ::-1])


def test_known_colours() -> None:
    """First and last colour as matplotlib has them."""
    ends = RAMP[:, [0, -1]]
    for name, first, last in (
        ("magma", (0, 0, 4), (252, 253, 191)),
        ("turbo", (48, 18, 59), (122, 4, 3)),
        ("gray", (0, 0, 0), (255, 255, 255)),
        ("Spectral", (158, 1, 66), (94, 79, 162)),
    ):
        np.testing.assert_array_equal(colorize(ends, vmin=1.0, vmax=5.0, colormap=name)[0], [first, last])


def test_invalid_is_grey_and_does_not_count() -> None:
    depth = RAMP.copy()
    depth[0, :4] = [0, -1, np.nan, np.inf]
    assert (colorize(depth)[0, :4] == INVALID_COLOR).all()
    assert depth_range(depth, percentiles=(0.0, 100.0)) == (depth[0, 4], 5)
    nothing = np.zeros((2, 3), np.float32)
    assert (colorize(nothing) == INVALID_COLOR).all()
    assert preview(np.zeros((2, 3, 3), np.uint8), nothing).dtype == np.uint8


def test_range() -> None:
    np.testing.assert_allclose(depth_range(RAMP, percentiles=(2.0, 85.0)), [1.08, 4.4], atol=1e-5)
    assert depth_range(RAMP, vmin=0.0, vmax=10.0) == (0, 10)
    low, high = depth_range(np.full((2, 2), 3.0))
    assert low == 3 < high
    for given in (np.nan, np.inf, -np.inf):
        for name in ("vmin", "vmax"):
            with pytest.raises(InputError, match=f"{name} must be a finite number"):
                depth_range(RAMP, **{name: given})
    for vmin, vmax in ((5.0, 1.0), (2.0, 2.0)):
        with pytest.raises(InputError, match="vmin must be below vmax"):
            depth_range(RAMP, vmin=vmin, vmax=vmax)
    with pytest.raises(InputError, match="no colour map 'jet'; there are magma"):
        colorize(RAMP, colormap="jet")
    with pytest.raises(InputError, match=r"no colour map 'magm_r': did you mean magma_r"):
        colorize(RAMP, colormap="magm_r")


@pytest.mark.parametrize(("vmin", "vmax"), [(0.5, 9.7), (3.0, 3.0001), (1e-3, 1e-2), (0.0, 80.0), (2.999, 1234.0)])
@pytest.mark.parametrize("height", [1, 60, 200, 1000])
def test_bar_runs_from_vmin_below_to_vmax_above(height: int, vmin: float, vmax: float) -> None:
    bar = color_bar(height, vmin=vmin, vmax=vmax, colormap="gray")
    assert bar.shape[0] == max(height, 60)
    column = bar[:, 8 if height < 300 else 30].astype(int)
    assert column[0].mean() > 250
    assert column[-1].mean() < 5
    assert (np.diff(column[:, 0]) <= 0).all()
    assert (bar[:, 40:] < 128).any(), "it has labels"


@pytest.mark.parametrize("size", [(1, 1), (2, 900), (900, 2), (37, 53), (50, 400), (3000, 2000)])
def test_preview_of_any_size_is_legible(size: tuple[int, int]) -> None:
    picture = preview(np.zeros((*size, 3), np.uint8), np.ones(size, np.float32))
    assert 120 <= picture.shape[0] <= 1000 or size[1] > 2 * size[0]
    assert 320 <= max(picture.shape[:2]) <= 2100


def test_preview_shows_the_photo_and_the_depth() -> None:
    image = np.full((400, 500, 3), (250, 10, 10), np.uint8)
    picture = preview(image, np.tile(np.linspace(1, 5, 500, dtype=np.float32), (400, 1)), colormap="gray")
    assert (picture[12:412, 12:512] == (250, 10, 10)).all()
    depth = picture[12:412, 524:1024, 0].astype(int)
    assert (np.diff(depth[0]) >= 0).all()
    assert depth[0, 0] < 5
    assert depth[0, -1] > 250


def test_sheet_holds_every_panel() -> None:
    red = panel(np.full((10, 20, 3), (255, 0, 0), np.uint8))
    blue = panel(np.full((30, 5, 3), (0, 0, 255), np.uint8), caption="blue")
    page = sheet([[red], [blue, red]], gap=4)
    assert (page == (255, 0, 0)).all(axis=2).sum() == 2 * red[..., 0].size
    assert (page == (0, 0, 255)).all(axis=2).sum() == 30 * 5


def test_an_end_that_is_given_holds_where_all_depth_is_beyond_it() -> None:
    depth = np.linspace(3, 8, 50, dtype=np.float32)[None]
    low, high = depth_range(depth, vmax=2.0)
    assert high == 2.0 > low
    assert len(np.unique(colorize(depth, vmax=2.0)[0], axis=0)) == 1  # all of the last colour
    low, high = depth_range(depth, vmin=9.0)
    assert low == 9.0 < high
