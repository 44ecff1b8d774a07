"""From readings to a calibration: the scale is found, a wrong reading does no harm and is named, errors are honest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.rooms import SIZE, read, room

from zoedepth.calibration import Calibration, calibrate
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera


def test_readings_that_agree_give_their_factor() -> None:
    depth, _ = room(error=0)
    found = calibrate(depth, read(1.7 * depth, 10))
    assert found.scale == pytest.approx(1.7, rel=0.02)
    assert found.power == 1
    assert found.n_readings == len(found.readings) == 10
    assert found.outliers == ()
    assert found.error_before == pytest.approx(1 - 1 / 1.7)
    assert found.error_after < 0.02


def test_one_reading_tells_the_scale_alone_and_not_with_certainty() -> None:
    depth = np.full(SIZE, 2.0, np.float32)
    near, far = (calibrate(depth, [(40, 30, 2 * factor)], form="scale-shift") for factor in (1.1, 3))
    assert near.power == far.power == 1
    assert 1.03 < near.scale < 1.07  # what the model errs by at one pixel is not taken for its scale
    assert 2.5 < far.scale < 3
    assert far.scale_error > 0.2


@pytest.mark.parametrize("factor", [0.1, 1 / 3.28, 3.28, 10])
def test_a_wrong_reading_among_ten_is_named_and_does_no_harm(factor: float) -> None:
    depth, truth = room()
    readings = [(x, y, 1.4 * metres) for x, y, metres in read(truth, 10)]
    right = calibrate(depth, readings)
    x, y, metres = readings[3]
    readings[3] = (x, y, factor * metres)
    wrong = calibrate(depth, readings)
    assert [reading.place for reading in wrong.outliers] == [f"{x},{y}"]
    assert right.outliers == ()
    assert wrong.scale == pytest.approx(right.scale, rel=0.05)


def test_a_wrong_one_of_three_is_named_and_of_two_none() -> None:
    depth, truth = room(error=0.02)
    (a, b, (x, y, metres)) = read(truth, 3)
    three = calibrate(depth, [a, b, (x, y, 10 * metres)])
    assert [reading.place for reading in three.outliers] == [f"{x},{y}"]
    assert three.scale == pytest.approx(1, abs=0.05)
    two = calibrate(depth, [a, (x, y, 10 * metres)])
    assert two.outliers == ()
    assert two.scale_error > 3 * three.scale_error


def test_wrong_ones_that_hide_each_other_are_all_named() -> None:
    depth, truth = room(error=0.05)
    readings = read(truth, 10)
    wrong = [(x, y, 8 * metres) for x, y, metres in readings[:3]]
    found = calibrate(depth, [*wrong, *readings[3:]])
    assert [reading.outlier for reading in found.readings] == [True] * 3 + [False] * 7
    assert found.scale == pytest.approx(1, abs=0.05)


def test_readings_in_another_unit_are_believed_where_all_agree() -> None:
    depth, truth = room(error=0.05)
    found = calibrate(depth, [(x, y, 100 * metres) for x, y, metres in read(truth, 3)])
    assert found.scale == pytest.approx(100, rel=0.1)


def test_more_readings_are_surer() -> None:
    depth, truth = room()
    errors = [calibrate(depth, read(truth, n)).scale_error for n in (1, 3, 10, 40)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < errors[0] / 4


def test_errors_grow_with_the_scatter_of_the_readings() -> None:
    calm, wild = (calibrate(depth, read(truth, 20)) for depth, truth in (room(error=0.03), room(error=0.3)))
    assert wild.scale_error > 2 * calm.scale_error
    assert wild.expected_error > 2 * calm.expected_error


@pytest.mark.parametrize("n", [1, 3, 10])
def test_the_truth_lies_within_the_stated_errors(n: int) -> None:
    scales, pixels = [], []
    for seed in range(30):
        depth, truth = room(error=0.12, seed=seed)
        scale = math.exp(np.random.default_rng(seed).normal(0, 0.12))
        found = calibrate(depth, [(x, y, scale * metres) for x, y, metres in read(truth, n, seed=seed)])
        ratios = np.log(scale * truth / found.apply(depth))
        scales.append(abs(np.median(ratios)) <= math.log1p(found.scale_error))
        pixels.append(np.mean(np.abs(ratios) <= math.log1p(found.expected_error)))
    assert np.mean(scales) >= 0.8
    assert np.mean(pixels) >= 0.8


class TestPower:
    def test_found_where_near_is_too_far_and_far_too_near(self) -> None:
        depth, _ = room(error=0)
        found = calibrate(depth, read(1.2 * depth**1.3, 30), form="scale-shift")
        assert found.power == pytest.approx(1.3, abs=0.02)
        np.testing.assert_allclose(found.apply(depth), 1.2 * depth**1.3, rtol=0.02)
        assert found.error_after < 0.02
        assert found.scale * found.middle ** (found.power - 1) == pytest.approx(1.2 * found.middle**0.3, rel=0.02)

    def test_left_out_where_it_does_not_help(self) -> None:
        depth, truth = room(error=0.1, seed=5)
        assert calibrate(depth, read(truth, 30), form="scale-shift") == calibrate(depth, read(truth, 30))

    def test_not_asked_of_few_readings_or_without_asking(self) -> None:
        depth, _ = room(error=0)
        assert calibrate(depth, read(depth**1.3, 4), form="scale-shift").power == 1
        assert calibrate(depth, read(depth**1.3, 30)).power == 1

    def test_needs_points(self) -> None:
        depth, _ = room()
        camera = Camera.from_fov(SIZE, horizontal=60)
        with pytest.raises(InputError, match="give points"):
            calibrate(depth, [((1, 1), (70, 50), 2.0)], camera=camera, form="scale-shift")


class TestSeveralPhotos:
    def chain(self, scales: list[float], n: int, **given: object) -> Calibration:
        """Return the calibration by ``n`` readings in each of as many photos as there are scales."""
        found = None
        for number, scale in enumerate(scales):
            depth, truth = room(error=0.05, seed=number)
            readings = [(x, y, scale * metres) for x, y, metres in read(truth, n, seed=number)]
            found = calibrate(depth, readings, photo=f"{number}.jpg", earlier=found)
        assert found is not None
        return found

    def test_the_scale_is_that_of_the_camera(self) -> None:
        found = self.chain([1.5, 1.8, 1.6, 1.7, 1.4], 3)
        assert found.scale == pytest.approx(1.6, rel=0.06)
        assert (found.n_readings, found.n_photos) == (15, 5)
        assert {reading.photo for reading in found.readings} == {f"{number}.jpg" for number in range(5)}
        assert found.expected_error == found.error_elsewhere

    def test_many_readings_of_one_photo_weigh_no_more_than_few_of_others(self) -> None:
        found = None
        for number, (scale, n) in enumerate([(1.3, 40), (1.6, 3), (1.6, 3), (1.6, 3)]):
            depth, truth = room(error=0.05, seed=number)
            readings = [(x, y, scale * metres) for x, y, metres in read(truth, n, seed=number)]
            found = calibrate(depth, readings, photo=str(number), earlier=found)
        assert found is not None
        assert found.scale > 1.4

    def test_a_photo_that_does_not_fit_does_little_harm(self) -> None:
        assert self.chain([1.5, 1.5, 1.5, 1.5, 15.0], 1).scale == pytest.approx(1.5, rel=0.15)
        assert [reading.outlier for reading in self.chain([1.5, 1.5, 1.5, 1.5, 15.0], 1).readings] == [False] * 4 + [
            True
        ]

    def test_one_photo_tells_less_of_others_than_of_itself(self) -> None:
        depth, truth = room()
        found = calibrate(depth, read(truth, 20))
        assert found.error_elsewhere > found.expected_error

    def test_a_photo_measured_again_replaces_its_readings(self) -> None:
        depth, truth = room()
        first = calibrate(depth, read(2 * truth, 5), photo="a.jpg")
        again = calibrate(depth, read(truth, 3), photo="a.jpg", earlier=first)
        assert again == calibrate(depth, read(truth, 3), photo="a.jpg")

    def test_readings_that_are_not_listed_go_with_their_photo(self) -> None:
        depth, truth = room()
        first = replace(calibrate(depth, read(2 * truth, 5), photo="a.jpg"), n_readings=500)  # a file lists some
        assert calibrate(depth, read(truth, 3), photo="a.jpg", earlier=first).n_readings == 3
        assert calibrate(depth, read(truth, 3), photo="b.jpg", earlier=first).n_readings == 503

    @pytest.mark.parametrize(
        ("changes", "given", "message"),
        [
            ({"power": 1.2}, {}, "of one photo"),
            ({}, {"form": "scale-shift"}, "of one photo"),
            ({}, {"photo": ""}, "name each photo"),
            ({"camera": Camera.from_fov(SIZE, horizontal=90)}, {}, "two cameras"),
        ],
    )
    def test_what_cannot_be_taken_together(self, changes: dict, given: dict, message: str) -> None:
        depth, truth = room()
        camera = Camera.from_fov(SIZE, horizontal=60)
        earlier = replace(calibrate(depth, read(truth, 3), photo="a.jpg", camera=camera), **changes)
        options = {"photo": "b.jpg", "camera": camera, "earlier": earlier} | given
        with pytest.raises(InputError, match=message):
            calibrate(depth, read(truth, 3), **options)


class TestRefuses:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"depth": np.ones(5, np.float32)}, "depth must be an array"),
            ({"valid": np.ones((2, 2), bool)}, "must be the same"),
            ({"camera": Camera.from_fov((2, 2), horizontal=60)}, "camera is of a photo of"),
        ],
    )
    @pytest.mark.usefixtures("unchecked_types")
    def test_what_does_not_fit_the_depth(self, given: dict, message: str) -> None:
        options = {"depth": room()[0], "readings": [(1, 1, 2.0)]} | given
        with pytest.raises(InputError, match=message):
            calibrate(**options)
