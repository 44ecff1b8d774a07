"""Readings: points, maps and distances are compared with the depth at their places, and what cannot be is refused."""

import math

import numpy as np
import pytest
from tests.calibration.rooms import SIZE, read, room

from zoedepth.calibration import calibrate, places_to_measure
from zoedepth.calibration.readings import MAX_USED, measure, spread_of
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth

CAMERA = Camera.from_fov(SIZE, horizontal=70)


def test_points_lists_arrays_and_maps_are_one() -> None:
    depth, truth = room()
    points = sorted(read(truth, 12), key=lambda point: (point[1], point[0]))
    sparse = np.full(SIZE, np.nan, np.float32)
    for x, y, metres in points:
        sparse[int(y), int(x)] = metres
    by_points = calibrate(depth, points)
    assert calibrate(depth, np.array(points)) == by_points
    assert calibrate(depth, sparse) == by_points
    assert calibrate(depth, np.nan_to_num(sparse)) == by_points


def test_a_dense_map_is_thinned_evenly() -> None:
    depth, truth = room()
    found = calibrate(depth, 1.3 * truth)
    assert MAX_USED / 2 < found.n_readings <= MAX_USED
    rows = [reading.points[0][1] for reading in found.readings]
    assert min(rows) == 0
    assert max(rows) >= SIZE[0] - 2
    assert found.scale == pytest.approx(1.3 * np.median(truth / depth), rel=0.02)


def test_very_many_points_are_taken_as_a_map_of_them_is() -> None:
    depth, truth = room()
    rows, columns = np.nonzero(truth > 0)
    points = np.stack([columns, rows, 1.3 * truth[rows, columns]], axis=1)
    assert len(points) > 2 * MAX_USED
    valid = np.ones(SIZE, bool)
    valid[:, :40] = False
    found = calibrate(depth, points, valid=valid)
    assert found == calibrate(depth, 1.3 * truth, valid=valid)
    with pytest.raises(InputError, match="no reading is at a pixel with valid depth"):
        calibrate(depth, points, valid=np.zeros(SIZE, bool))
    points[::5, 2] = 65.535
    with pytest.raises(InputError, match=r"of the readings hold the largest value, 65\.535 m"):
        calibrate(depth, points)


def test_pixels_without_valid_depth_are_passed_over_in_maps() -> None:
    depth, truth = room(error=0)
    depth[:30] = np.nan
    valid = np.ones(SIZE, bool)
    valid[:, :40] = False
    found = calibrate(depth, truth, valid=valid)
    assert all(y >= 30 and x >= 40 for ((x, y),) in (reading.points for reading in found.readings))
    with pytest.raises(InputError, match="no reading at a pixel with valid depth"):
        calibrate(depth, truth, valid=np.zeros(SIZE, bool))
    with pytest.raises(InputError, match="no reading at a pixel"):
        calibrate(depth, np.zeros(SIZE, np.float32))


def test_fractions_of_pixels_are_rounded_and_the_border_belongs_to_the_photo() -> None:
    depth, _ = room(error=0)
    corner = calibrate(depth, [(79.4, 59.4, 1.0)]).readings[0]
    assert corner.before == pytest.approx(float(depth[59, 79]))
    assert calibrate(depth, [(-0.4, -0.4, 1.0)]).readings[0].before == pytest.approx(float(depth[0, 0]))


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ((80, 30, 2.0), "80,30=2 lies outside of the photo, which has columns 0 to 79 and rows 0 to 59"),
        ((30, 60, 2.0), "outside of the photo"),
        ((-1, 30, 2.0), "outside of the photo"),
        ((math.nan, 30, 2.0), "outside of the photo"),
        ((40, 30, 0.0), "40,30=0 must be above 0"),
        ((40, 30, -1.0), "above 0"),
        ((40, 30, math.nan), "above 0 and finite"),
        ((40, 30, math.inf), "above 0 and finite"),
        ((3, 3, 2.0), "3,3=2 is at a pixel without valid depth"),
        ((5, 3, 2.0), "without valid depth"),
        (((40, 30), (3, 3), 2.0), "40,30,3,3=2 is at a pixel without valid depth"),
        (((40, 30), (40, 90), 2.0), "outside of the photo"),
        (((40, 30), (40, 30), 2.0), "same point twice"),
        (((40, 30), (50, 30), 0.0), "above 0"),
        ((40, 30), "a reading is"),
        ((40, "here", 2.0), "a reading is"),
        ((40, (1, 2), 2.0), "a reading is"),
        (5.0, "a reading is"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_what_is_no_reading_is_refused(reading: object, message: str) -> None:
    depth, _ = room()
    depth[3, 3] = 0
    valid = np.ones(SIZE, bool)
    valid[3, 5] = False
    with pytest.raises(InputError, match=message):
        calibrate(depth, [(40, 30, 2.0), reading], camera=CAMERA, valid=valid)


@pytest.mark.usefixtures("unchecked_types")
def test_none_and_arrays_of_other_shapes_are_refused() -> None:
    depth, _ = room()
    with pytest.raises(InputError, match="no reading"):
        calibrate(depth, [])
    with pytest.raises(InputError, match=r"map of the depth's size \(60, 80\) or \(N, 3\)"):
        calibrate(depth, np.ones((30, 40)))


class TestDistances:
    def test_are_compared_in_space(self) -> None:
        depth, _ = room(error=0)
        one, other = (depth[y, x] * CAMERA.ray(x, y) for x, y in ((10, 20), (70, 45)))
        found = calibrate(depth, [((10, 20), (70, 45), 1.8 * math.dist(one, other))], camera=CAMERA)
        (reading,) = found.readings
        assert reading.before == pytest.approx(math.dist(one, other))
        assert reading.after == pytest.approx(found.scale * math.dist(one, other))
        assert reading.place == "10,20,70,45"
        assert 1.3 < found.scale < 1.8

    def test_along_the_line_of_sight_are_less_sure(self) -> None:
        depth = np.full(SIZE, 2.0, np.float32)
        depth[:, 40:50] = 2.4
        known = known_depth(depth)
        sideways, inwards = (
            measure(depth, [reading], CAMERA, known, along_ray=False).spread[0]
            for reading in (((15, 30), (64, 30), 1.0), ((35, 30), (44, 30), 0.5))
        )
        assert sideways == 1
        assert inwards > 3

    def test_need_the_camera(self) -> None:
        with pytest.raises(InputError, match="needs the camera"):
            calibrate(room()[0], [((10, 20), (70, 45), 1.0)])


class TestAlongTheRay:
    def test_the_length_of_the_ray_is_compared(self) -> None:
        depth, _ = room(error=0)
        length = np.linalg.norm(CAMERA.ray(75, 5)) * float(depth[5, 75])
        (reading,) = calibrate(depth, [(75, 5, length)], camera=CAMERA, along_ray=True).readings
        assert reading.before == pytest.approx(length)
        assert length > 1.1 * depth[5, 75]

    def test_needs_the_camera(self) -> None:
        with pytest.raises(InputError, match="along the ray need the camera"):
            calibrate(room()[0], [(75, 5, 1.0)], along_ray=True)


class TestJumps:
    def test_the_median_is_taken_and_the_reading_named(self) -> None:
        depth = np.full(SIZE, 2.0, np.float32)
        depth[:, 40:] = 4.0
        at_jump, beside = calibrate(depth, [(40, 30, 2.0), (10, 30, 2.0)]).readings
        assert at_jump.at_jump
        assert not beside.at_jump
        assert at_jump.before in (2, 4)  # 39 to 41: of the nine pixels, six are far
        assert at_jump.before == 4
        assert at_jump.spread > 3 * beside.spread

    def test_weigh_less(self) -> None:
        depth = np.full(SIZE, 2.0, np.float32)
        depth[:, 40:] = 2.3
        readings = [(10, 30, 2.0), (70, 30, 2.3)]
        at_jump, beside = (calibrate(depth, [*readings, low]).scale for low in ((40, 30, 1.84), (20, 30, 1.6)))
        assert beside < at_jump - 0.02

    def test_unknown_pixels_around_do_not_count(self) -> None:
        depth = np.full(SIZE, 2.0, np.float32)
        depth[:, 41:] = np.inf
        (reading,) = calibrate(depth, [(40, 30, 2.0)]).readings
        assert not reading.at_jump
        assert reading.before == 2

    def test_the_spread_is_that_of_smooth_ground_times_something(self) -> None:
        np.testing.assert_allclose(spread_of(np.array([0, 0.05, 0.1])), [1, math.sqrt(2), math.sqrt(5)])


class TestPlacesToMeasure:
    def test_are_smooth_and_near_middle_and_far(self) -> None:
        depth, _ = room(error=0)
        depth[:, 50:60] *= np.random.default_rng(0).uniform(0.5, 2, (60, 10)).astype(np.float32)
        places = places_to_measure(depth, np.ones(SIZE, bool))
        assert len(places) == 3
        depths = [float(depth[y, x]) for x, y in places]
        assert depths == sorted(depths)
        assert depths[2] > 1.3 * depths[0]
        assert all(5 < x < 75 and 5 < y < 55 and not 50 <= x < 60 for x, y in places)

    def test_are_fewer_where_little_is_valid(self) -> None:
        depth, _ = room()
        valid = np.zeros(SIZE, bool)
        assert places_to_measure(depth, valid) == []
        valid[20:30, 30:40] = True
        for x, y in places_to_measure(depth, valid):
            assert valid[y, x]


@pytest.mark.parametrize("share", [0.03, 0.9])
def test_holes_that_are_stored_as_the_largest_number_are_no_readings(share: float) -> None:
    generator = np.random.default_rng(0)
    depth = generator.uniform(1, 5, SIZE).astype(np.float32)
    sparse = np.where(generator.random(SIZE) < share, 65.535, 1.2 * depth)
    with pytest.raises(InputError, match=r"largest value, 65\.535 m, .* it stands for unknown\. Write 0 there"):
        calibrate(depth, sparse)


def test_a_point_between_two_pixels_is_at_that_of_the_depth_map() -> None:
    depth = np.arange(1, 9, dtype=np.float32)[None].repeat(3, axis=0)
    for x in (1.5, 2.5, 3.5, 4.5):
        measured = measure(depth, [(x, 1, 2.0)], None, np.ones(depth.shape, bool), along_ray=False)
        assert measured.depth[0, 0] == depth[1, int(x + 0.5)]


def test_a_sparse_map_in_another_unit_is_refused() -> None:
    depth = np.full((8, 10), 2.0, np.float32)
    with pytest.raises(InputError, match=r"the median of the sparse depth map is 2500 m\. "):
        measure(depth, 1250 * depth, None, depth > 0, along_ray=False)
