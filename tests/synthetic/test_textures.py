from dataclasses import replace

import numpy as np
import pytest

from zoedepth.synthetic.textures import PATTERNS, Surface, fractional, pattern_albedo

ONE, OTHER = np.array((0.6, 0.3, 0.2)), np.array((0.1, 0.5, 0.8))


def surface(u: np.ndarray, v: np.ndarray, *, pixel: float = 1e-4, scale: float = 0.5, half: float = 2.0) -> Surface:
    n = len(u)

    def column(value: float) -> np.ndarray:
        return np.full(n, value, np.float32)

    return Surface(u, v, column(pixel), column(half), column(half), column(scale), column(0.37),
                   np.broadcast_to(ONE, (n, 3)), np.broadcast_to(OTHER, (n, 3)), np.zeros(n, np.float32))  # fmt: skip


def grid(n: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    line = (np.arange(n) + 0.5) / n * side - side / 2
    u, v = np.meshgrid(line, line)
    return u.ravel(), v.ravel()


def share(colors: np.ndarray) -> np.ndarray:
    """Return how far each colour's hue is from the first (0) to the second (1), whatever its brightness."""
    ratio = colors[:, 2] / colors[:, 0]  # 1/3 of the first, 8 of the second
    return (ratio * ONE[0] - ONE[2]) / ((OTHER[2] - ONE[2]) - ratio * (OTHER[0] - ONE[0]))


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("pixel", [1e-4, 0.03, 3.0])
def test_colours_are_those_of_surfaces(pattern: str, pixel: float) -> None:
    points = surface(*grid(40, 3.9), pixel=pixel)
    colors = pattern_albedo(pattern, points)
    assert colors.shape == (1600, 3)
    assert np.isfinite(colors).all()
    assert colors.min() >= 0.003
    assert colors.max() <= 0.95
    assert (points.mirror >= 0).all()
    assert (points.mirror <= 1).all()


@pytest.mark.parametrize("pattern", sorted(set(PATTERNS) - {"view", "picture"}))
def test_pattern_is_seen_from_close_by(pattern: str) -> None:
    """No pattern is of one colour; ``plain`` varies by a little."""
    colors = pattern_albedo(pattern, surface(*grid(60, 3.9)))
    spread = (colors / colors.mean(0)).std(0).max()
    assert spread > (0.02 if pattern in ("plain", "plaster") else 0.05)


@pytest.mark.parametrize(
    ("pattern", "u_period", "v_period"),
    [("stripes", 0.5, None), ("slats", None, 0.5), ("checks", 0.5, 0.5), ("plaid", 0.5, 0.5), ("dots", 0.5, 1.0)],
)
def test_pattern_repeats_after_its_scale(pattern: str, u_period: float | None, v_period: float | None) -> None:
    u, v = grid(23, 1.7)
    expected = share(pattern_albedo(pattern, surface(u, v)))
    assert expected.std() > 0.1
    for du, dv in ((u_period or 0.123, 0), (0, v_period or 0.123)):
        np.testing.assert_allclose(share(pattern_albedo(pattern, surface(u + du, v + dv))), expected, atol=1e-4)
    half = share(pattern_albedo(pattern, surface(u + (u_period or 0) / 2, v + (0 if u_period else v_period or 0) / 2)))
    assert np.abs(half - expected).max() > 0.45


def test_stripes_and_checks_are_where_they_should() -> None:
    u, v = np.array([0.0, 0.25, 0.5, 0.0]), np.array([0.0, 0.0, 0.0, 0.25])
    np.testing.assert_allclose(share(pattern_albedo("stripes", surface(u, v))), [1, 0, 1, 1], atol=1e-4)
    np.testing.assert_allclose(share(pattern_albedo("checks", surface(u, v))), [0, 1, 0, 1], atol=1e-4)


@pytest.mark.parametrize(
    "pattern", ["stripes", "checks", "plaid", "dots", "slats", "tiles", "facade", "carpet", "text"]
)
def test_large_pixels_show_the_mean_of_small_ones(pattern: str) -> None:
    """The far view of a pattern is the average of the near one: nothing flickers, nothing changes its tint."""
    points = grid(160, 4.0)
    near = pattern_albedo(pattern, surface(*points, pixel=0.002)).mean(0)
    far = pattern_albedo(pattern, surface(*points, pixel=1.0)).mean(0)
    tolerance = 0.2 if pattern in ("text", "facade") else 0.08
    np.testing.assert_allclose(far, near, atol=tolerance * near.max())


def test_joints_cover_their_share_of_tiles() -> None:
    colors = pattern_albedo("tiles", surface(*grid(800, 4.0), pixel=0.005))
    width = 0.012 * 0.5 + 0.003
    expected = 1 - (1 - width / 0.5) ** 2
    assert np.clip(share(colors), 0, 1).mean() == pytest.approx(expected, rel=0.15)


def test_rows_of_bricks_are_shifted_by_half_a_brick() -> None:
    height, length = 0.09 * 0.5, 0.26 * 0.5
    middle = height / 2  # of row 0; rows 1 and 2 are one and two heights up
    for row, u in ((0, 0.0), (1, length / 2), (2, 0.0)):
        at = surface(np.array([u, u + length / 2]), np.full(2, middle + row * height))
        joint, brick = share(pattern_albedo("bricks", at))
        assert joint > 0.7
        assert brick < 0.1


def test_wood_and_bark_run_along_their_grain() -> None:
    def steps(pattern: str) -> tuple[float, float]:
        colors = pattern_albedo(pattern, surface(*grid(120, 0.5), scale=1.0)).mean(1).reshape(120, 120)
        return float(np.abs(np.diff(colors, axis=1)).mean()), float(np.abs(np.diff(colors, axis=0)).mean())

    along, across = steps("wood")
    assert across > 2 * along
    along, across = steps("bark")
    assert along > 2 * across  # up the trunk


def test_windows_of_a_facade_mirror_and_its_wall_does_not() -> None:
    points = surface(*grid(240, 12.0), scale=3.0, half=6.0, pixel=0.01)
    colors = pattern_albedo("facade", points)
    pane = np.asarray(points.mirror > 0.3)
    assert 0.08 < pane.mean() < 0.6
    assert points.mirror[~pane].min() == 0
    assert colors[pane].mean() < 0.25 * colors[points.mirror == 0].mean()  # it is dark behind windows
    # Four storeys of 3 m; the windows are at one height of each, above the floor and below the ceiling.
    storeys = np.asarray(pane.reshape(4, 60, 240).any(axis=2))
    assert (storeys[1:] == storeys[1]).all()
    assert storeys[1, 25:38].sum() > 8  # a bar may cross them
    assert not storeys[:, :6].any()


def test_writing_keeps_off_the_edge() -> None:
    points = surface(*grid(300, 3.99), scale=0.4)
    ink = share(pattern_albedo("text", points)) > 0.5
    edge = np.minimum(2 - np.abs(points.u), 2 - np.abs(points.v))
    assert ink[edge > 0.14].mean() > 0.1
    assert not ink[edge < 0.13].any()


def test_ornament_has_a_border() -> None:
    points = surface(*grid(200, 3.99), scale=0.4)
    shares = share(pattern_albedo("ornament", points)).reshape(200, 200)
    # Along the border nothing changes, across it does.
    assert np.abs(np.diff(shares[3, 40:160])).max() < 0.01
    assert np.abs(np.diff(shares[:30, 100])).max() > 0.02
    assert np.abs(np.diff(shares[100, 60:140])).max() > 0.02


def test_parts_differ_in_what_is_random_only() -> None:
    points = surface(*grid(20, 2.0))
    other = replace(points, random=np.full(400, 0.83, np.float32))
    np.testing.assert_array_equal(pattern_albedo("wood", points), pattern_albedo("wood", points))
    assert np.abs(pattern_albedo("wood", points) - pattern_albedo("wood", other)).max() > 0.05


def test_fractional_is_a_fair_hash() -> None:
    u, v = (a.ravel().astype(np.float32) for a in np.meshgrid(np.arange(-50, 50), np.arange(-50, 50)))
    values = fractional(u, v)
    assert values.min() >= 0
    assert values.max() < 1
    counts = np.histogram(values, 10, (0, 1))[0]
    assert counts.min() > 800  # of 1000
    assert counts.max() < 1200
    table = values.reshape(100, 100)
    for axis in (0, 1):
        a, b = np.take(table, range(99), axis).ravel(), np.take(table, range(1, 100), axis).ravel()
        assert abs(np.corrcoef(a, b)[0, 1]) < 0.05
    np.testing.assert_array_equal(values, fractional(u.copy(), v.copy()))
    assert (fractional(u, v) != fractional(v, u)).mean() > 0.9
