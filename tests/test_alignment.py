"""Alignment of a prediction with the truth, against torch, numpy's least squares, and values by hand."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from zoedepth.alignment import align_least_squares, align_median, resize_depth

EVERYWHERE = np.ones((1, 4), dtype=bool)


def test_resizing_is_that_of_torch_with_aligned_corners() -> None:
    x = np.random.default_rng(0).uniform(1, 9, size=(7, 11)).astype(np.float32)
    expected = F.interpolate(torch.tensor(x)[None, None], (20, 13), mode="bilinear", align_corners=True)[0, 0]
    np.testing.assert_array_equal(resize_depth(x, (20, 13)), expected.numpy())


def test_resizing_keeps_the_corners_and_halves_between_them() -> None:
    found = resize_depth(np.array([[1.0, 3.0], [3.0, 5.0]]), (3, 3))
    np.testing.assert_array_equal(found, [[1, 2, 3], [2, 3, 4], [3, 4, 5]])


def test_depth_of_the_right_size_is_returned_as_it_is() -> None:
    x = np.random.default_rng(0).uniform(1, 9, size=(7, 11))  # float64 stays float64
    assert resize_depth(x, (7, 11)) is x


def test_median_is_aligned_over_the_given_pixels_and_the_factor_applied_to_all() -> None:
    x, target = np.array([[1.0, 2.0, 3.0, 100.0]]), np.array([[4.0, 8.0, 12.0, 0.5]])
    where = np.array([[True, True, True, False]])
    np.testing.assert_array_equal(align_median(x, target, where), [[4, 8, 12, 400]])


def test_median_of_zero_divides_by_a_millionth() -> None:
    found = align_median(np.array([[0.0, 0.0, 0.0, 1.0]]), np.full((1, 4), 2.0), EVERYWHERE)
    np.testing.assert_allclose(found, [[0, 0, 0, 2e6]])


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (-3.0, 0.5), (0.25, 2.0)])
def test_least_squares_finds_scale_and_shift(scale: float, shift: float) -> None:
    target = np.random.default_rng(0).uniform(0, 1, size=(5, 6))
    found = align_least_squares((target - shift) / scale, target, np.ones((5, 6), dtype=bool))
    np.testing.assert_allclose(found, target, rtol=0, atol=1e-12)


def test_least_squares_is_that_of_numpy_over_the_given_pixels_applied_to_all() -> None:
    rng = np.random.default_rng(0)
    x, target, where = rng.uniform(0, 1, (8, 9)), rng.uniform(0, 1, (8, 9)), rng.random((8, 9)) < 0.5
    design = np.stack([x[where], np.ones(where.sum())], axis=1)
    scale, shift = np.linalg.lstsq(design, target[where], rcond=None)[0]
    np.testing.assert_allclose(align_least_squares(x, target, where), scale * x + shift, rtol=1e-9)


def test_least_squares_of_one_value_at_the_given_pixels_is_the_mean_of_the_target_everywhere() -> None:
    x, where = np.array([[0.5, 0.5, 0.5, 9.0]]), np.array([[True, True, True, False]])
    found = align_least_squares(x, np.array([[1.0, 2.0, 6.0, 0.0]]), where)
    np.testing.assert_array_equal(found, np.full((1, 4), 3.0))
