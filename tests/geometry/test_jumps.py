from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.geometry.flying import blurred, draw_room

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.jumps import find_flying, flying_pixels, jumps, tolerance

SIZE = (48, 64)
CAMERA = Camera.from_fov(SIZE, horizontal=60)


def floor(size: tuple[int, int] = (240, 320), height: float = 1.5) -> tuple[np.ndarray, Camera]:
    """Return the depth of a level floor far ahead, seen by a camera that looks 40 degrees down or less."""
    camera = Camera.from_fov(size, horizontal=60)
    pitch = np.radians(25)
    down = camera.rays() @ np.array([0, np.cos(pitch), np.sin(pitch)])
    return (height / down).astype(np.float32), camera


def step(near: float = 1.0, far: float = 3.0) -> np.ndarray:
    """Return a square before a wall."""
    depth = np.full(SIZE, far, np.float32)
    depth[16:32, 20:44] = near
    return depth


def ramp(width: int, near: float = 1.0, far: float = 3.0, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return a near half and a far half with a straight ramp of so many pixels between."""
    columns = np.arange(size[1]) - size[1] / 2 + 0.5
    return np.broadcast_to(near + (far - near) * np.clip(columns / width + 0.5, 0, 1), size).astype(np.float32)


def test_jumps_are_where_depth_jumps_and_nowhere_else() -> None:
    across, along = jumps(step(), CAMERA)
    expected = np.zeros(SIZE, bool)
    expected[16:32, [19, 43]] = True
    assert np.array_equal(across, expected[:, :-1])
    expected = np.zeros(SIZE, bool)
    expected[[15, 31], 20:44] = True
    assert np.array_equal(along, expected[:-1])


@pytest.mark.parametrize("scale", [0.2, 1.0, 30.0])
def test_jumps_below_the_tolerance_are_none(scale: float) -> None:
    near = 2.0 * scale
    for factor, found in ((0.8, False), (1.3, True)):
        depth = step(near, near + factor * float(tolerance(np.float64(near))))
        camera = Camera.from_focal(2000.0, SIZE)  # so that all of them are steep
        assert jumps(depth, camera)[0].any() == found


def test_tolerance_grows_with_the_depth() -> None:
    depth = np.geomspace(0.01, 1000, 200)
    assert (np.diff(tolerance(depth)) >= 0).all()
    assert tolerance(np.float64(3.0)) == 0.045
    np.testing.assert_allclose(tolerance(np.array([0.1, 100.0])), [0.003, 0.5])


def test_a_floor_seen_nearly_along_it_neither_jumps_nor_flies() -> None:
    depth, camera = floor()
    steepest = (np.abs(np.diff(depth, axis=0)) / depth[:-1] * camera.fy).max()
    assert steepest > 7  # beyond STEEP
    across, along = jumps(depth, camera)
    assert not across.any()
    assert not along.any()
    assert not flying_pixels(depth, camera).any()


def test_unknown_depth_is_on_no_surface() -> None:
    depth = np.full(SIZE, 2.0, np.float32)
    depth[5, 7], depth[20:24, 30:40] = np.nan, 0
    across, along = jumps(depth, CAMERA)
    assert across[5, 6]
    assert across[5, 7]
    assert along[4, 7]
    assert along[5, 7]
    assert across.sum() == 2 + 4 * 11
    assert not flying_pixels(depth, CAMERA).any()


def test_sharp_jumps_have_no_flying_pixels() -> None:
    assert not flying_pixels(step(), CAMERA).any()


@pytest.mark.parametrize(("width", "found"), [(2, 1.0), (4, 1.0), (7, 1.0), (12, 0.9)])
def test_pixels_in_a_ramp_fly(width: int, found: float) -> None:
    for depth, camera in (
        (ramp(width), CAMERA),
        (ramp(width, size=SIZE[::-1]).T, CAMERA),  # a ramp downwards
        (ramp(width)[:, ::-1], CAMERA),
    ):
        flying = flying_pixels(np.ascontiguousarray(depth), camera)
        between = np.minimum(depth - 1, 3 - depth)
        assert flying[between > 0.1].mean() >= found
        assert not flying[between <= 0.02].any()


@pytest.mark.parametrize("factor", [1, 3, 8])
def test_ramps_are_found_whatever_the_size_of_the_picture(factor: int) -> None:
    size = (60 * factor, 80 * factor)
    depth = ramp(3 * factor, size=size)
    camera = Camera.from_fov(size, horizontal=60)
    between = np.minimum(depth - 1, 3 - depth)
    flying = flying_pixels(depth, camera)
    assert flying[between > 0.3].mean() > 0.9
    assert not flying[:, : 20 * factor].any()
    assert not flying[:, -20 * factor :].any()


def test_thin_things_that_are_smeared_fly_whole() -> None:
    columns = np.arange(SIZE[1])
    bump = np.clip(1 - np.abs(columns - 30) / 4, 0, 1)  # a pole a pixel wide, whose depth never comes through
    depth = np.broadcast_to(3 - 0.7 * bump, SIZE).astype(np.float32)
    assert flying_pixels(depth, CAMERA)[:, 28:33].all()


def test_of_rendered_rooms_most_flying_pixels_are_found_and_few_good_ones_lost() -> None:
    counts = np.zeros(4)
    for seed in (0, 3):
        case = blurred(draw_room(seed))
        found = flying_pixels(case.depth, case.camera)
        counts += (found & case.flying).sum(), case.flying.sum(), (found & case.good).sum(), case.good.sum()
    removed, flying, lost, good = counts
    assert flying > 5000
    assert removed / flying >= 0.9
    assert lost / good <= 0.02


@settings(max_examples=40)
@given(arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.floats(0, 2**20, width=32)))
def test_any_depth_has_jumps_and_flying_pixels_of_its_size(depth: np.ndarray) -> None:
    camera = Camera.from_focal(5.0, (depth.shape[0], depth.shape[1]))
    across, along = jumps(depth, camera)
    assert across.shape == (depth.shape[0], depth.shape[1] - 1)
    assert along.shape == (depth.shape[0] - 1, depth.shape[1])
    flying = flying_pixels(depth, camera)
    assert flying.shape == depth.shape
    assert not flying[depth <= 0].any()


def test_rows_may_have_focal_lengths_of_their_own() -> None:
    depth = ramp(6, 2.0, 2.2)  # steep enough for the long focal length alone
    focal = np.where(np.arange(SIZE[0]) < 20, 10.0, 2000.0)[:, None]
    flying = find_flying(depth, focal, 10.0)
    assert not flying[:20].any()
    assert flying[26:].any(axis=1).all()  # those before are near pixels that are taken for a surface


@pytest.mark.parametrize("function", [jumps, flying_pixels])
def test_the_camera_must_be_that_of_the_depth(function: Callable[[np.ndarray, Camera], object]) -> None:
    with pytest.raises(InputError, match="camera"):
        function(np.ones((3, 3)), CAMERA)


@pytest.mark.parametrize("size", [(1, 700), (700, 1), (2, 1300), (4, 2500), (1, 1)])
def test_thin_maps_have_flying_pixels_or_none(size: tuple[int, int]) -> None:
    assert not flying_pixels(np.full(size, 2.0, np.float32), Camera.from_fov(size, horizontal=60)).any()
