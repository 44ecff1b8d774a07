"""Scores by hand on known arrays: which pixels count, with which values, and what the prediction is given first."""

import dataclasses
import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.evaluation.samples import EVERYWHERE, photo, prediction_of, sample_of

from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import Prediction
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Protocol
from zoedepth.evaluation.scoring import RANGES, Score, aligned_depth, score, scored_pixels
from zoedepth.metrics import Metrics, add_sums, mean_metrics, pixel_sums

MEDIAN = replace(EVERYWHERE, alignment="median")
DISPARITY = replace(EVERYWHERE, alignment="disparity")


def metrics_of(depth: object, truth: object, protocol: Protocol = EVERYWHERE, **prediction: object) -> Metrics:
    """Compute the metrics of a prediction (metres unless it is relative) against a truth."""
    sums = score(prediction_of(depth, **prediction), sample_of(truth), protocol).sums
    assert sums is not None
    return sums.metrics()


# ---------------------------------------------------------------------------------------------------- known errors


def test_prediction_a_quarter_too_far() -> None:
    found = metrics_of([[2.5, 5.0]], [[2.0, 4.0]])
    assert found.rel == pytest.approx(0.25, abs=1e-9)
    assert found.rmse == pytest.approx(math.sqrt((0.5**2 + 1.0**2) / 2), abs=1e-9)
    assert found.log10 == pytest.approx(math.log10(1.25), abs=1e-9)
    assert found.sq_rel == pytest.approx((0.25 / 2 + 1 / 4) / 2, abs=1e-9)
    assert found.rmse_log == pytest.approx(math.log(1.25), abs=1e-9)
    assert found.silog == pytest.approx(0, abs=1e-9)
    # A ratio of 1.25 is not below 1.25, but below 1.25 squared.
    assert (found.delta1, found.delta2, found.delta3) == (0, 1, 1)


def test_perfect_prediction() -> None:
    assert metrics_of([[2.0, 4.0]], [[2.0, 4.0]]) == Metrics(0, 0, 0, 1, 1, 1, 0, 0, 0)


def test_mixed_errors_of_four_pixels() -> None:
    # Values that float32 has exactly; ratios 1.1875, 1.5, 4 / 2.75 = 1.4545, 2 against 1.25, 1.5625, 1.953125.
    found = metrics_of([[1.1875, 1.0], [2.75, 8.0]], [[1.0, 1.5], [4.0, 4.0]])
    assert (found.delta1, found.delta2, found.delta3) == (0.25, 0.75, 0.75)
    assert found.rel == pytest.approx((0.1875 + 1 / 3 + 0.3125 + 1.0) / 4, abs=1e-9)
    assert found.rmse == pytest.approx(math.sqrt((0.1875**2 + 0.5**2 + 1.25**2 + 4**2) / 4), abs=1e-9)
    assert found.sq_rel == pytest.approx((0.1875**2 + 0.5**2 / 1.5 + 1.25**2 / 4 + 4**2 / 4) / 4, abs=1e-9)
    logs = [math.log(1.1875), math.log(1 / 1.5), math.log(2.75 / 4), math.log(2)]
    mean = sum(logs) / 4
    assert found.log10 == pytest.approx(sum(map(abs, logs)) / 4 / math.log(10), abs=1e-9)
    assert found.rmse_log == pytest.approx(math.sqrt(sum(x**2 for x in logs) / 4), abs=1e-9)
    assert found.silog == pytest.approx(100 * math.sqrt(sum((x - mean) ** 2 for x in logs) / 4), abs=1e-9)


@pytest.mark.parametrize(
    ("factor", "deltas"),
    [(1.125, (1, 1, 1)), (1.25, (0, 1, 1)), (1.5625, (0, 0, 1)), (1.953125, (0, 0, 0)), (0.75, (0, 1, 1))],
)
def test_scaled_prediction_has_the_deltas_it_must(factor: float, deltas: tuple[int, int, int]) -> None:
    truth = np.random.default_rng(0).integers(1, 64, size=(40, 50)) / 16  # no product is rounded
    found = metrics_of(factor * truth, truth)
    assert (found.delta1, found.delta2, found.delta3) == deltas
    assert found.rel == pytest.approx(abs(factor - 1), abs=1e-9)


def test_mean_is_over_photos_not_pixels() -> None:
    one, many = metrics_of([[3.0]], [[2.0]]), metrics_of([[2.0] * 9], [[2.0] * 9])
    assert mean_metrics([one, many]).rel == pytest.approx(0.25, abs=1e-9)


# ---------------------------------------------------------------------------------------------------- which pixels


def test_unknown_pixels_and_those_beyond_the_range_are_not_scored() -> None:
    found = score(
        prediction_of([[3.0, 9.0, 9.0, 9.0, 9.0, 9.0]]), sample_of([[2.0, 0.0, 10.0, 30.0, 1e-3, 5e-4]]), EVERYWHERE
    ).sums
    assert found is not None
    assert (found.n_pixels, found.rel) == (1, 0.5)


def test_range_from_zero_scores_every_positive_depth() -> None:
    protocol = replace(EVERYWHERE, min_depth=0.0)
    assert scored_pixels(sample_of([[0.0, 1e-5, 5e-4, 9.0]]), protocol).tolist() == [[False, True, True, True]]


def test_known_is_what_the_mask_says_not_the_depth() -> None:
    sample = replace(sample_of([[2.0, 2.0]]), mask=torch.tensor([[[True, False]]]))
    found = score(prediction_of([[3.0, 9.0]]), sample, EVERYWHERE).sums
    assert found is not None
    assert (found.n_pixels, found.rel) == (1, 0.5)


def test_without_the_mask_every_finite_depth_in_range_is_scored() -> None:
    sample = sample_of([[2.0, 2.0, 0.0, math.nan, math.inf, 10.0]])
    sample = replace(sample, mask=torch.zeros_like(sample.mask))
    assert not scored_pixels(sample, EVERYWHERE).any()
    expected = [[True, True, False, False, False, False]]
    assert scored_pixels(sample, replace(EVERYWHERE, use_mask=False)).tolist() == expected
    found = score(prediction_of(np.full((1, 6), 3.0)), sample, replace(EVERYWHERE, use_mask=False)).sums
    assert found is not None
    assert (found.n_pixels, found.rel) == (2, 1.0)


@pytest.mark.parametrize(
    ("protocol", "size", "inside"),
    [
        (INDOOR, (480, 640), (slice(45, 471), slice(41, 601))),
        (OUTDOOR, (352, 1216), (slice(143, 349), slice(43, 1172))),
        (replace(INDOOR, crop="eigen-scaled"), (240, 320), (slice(22, 236), slice(20, 300))),
    ],
    ids=["eigen", "garg", "eigen-scaled"],
)
def test_errors_outside_the_crop_do_not_count_and_all_inside_do(
    protocol: Protocol, size: tuple[int, int], inside: tuple[slice, slice]
) -> None:
    depth = np.full(size, 9.0)
    depth[inside] = 5.0
    found = score(prediction_of(depth), sample_of(np.full(size, 4.0)), protocol).sums
    assert found is not None
    n_pixels = (inside[0].stop - inside[0].start) * (inside[1].stop - inside[1].start)
    assert (found.n_pixels, found.rel) == (n_pixels, 0.25 * n_pixels)


@pytest.mark.parametrize(
    ("truth", "protocol"),
    [([[0.0]], EVERYWHERE), ([[20.0]], EVERYWHERE), (np.full((40, 40), 2.0), replace(INDOOR, crop="eigen"))],
    ids=["unknown", "too far", "outside the crop"],
)
def test_photo_without_a_scored_pixel_has_no_score(truth: object, protocol: Protocol) -> None:
    depth = prediction_of(np.full(np.shape(truth), 2.0), std=np.ones(np.shape(truth)))
    routed = depth._replace(domain="outdoor")
    assert score(routed, sample_of(truth), protocol) == Score("photo.jpg", "indoor", "outdoor", None)


# ---------------------------------------------------------------------------------------------------- which values


@pytest.mark.parametrize(
    ("prediction", "counts_as"),
    [(100.0, 10.0), (math.inf, 10.0), (math.nan, 1e-3), (-math.inf, 1e-3), (-1.0, 1e-3), (0.0, 1e-3)],
)
def test_prediction_counts_as_the_nearest_in_range_and_nan_as_near(prediction: float, counts_as: float) -> None:
    found = metrics_of([[prediction]], [[4.0]])
    assert found.rel == pytest.approx(abs(counts_as - 4) / 4, abs=1e-9)
    assert found.log10 == pytest.approx(abs(math.log10(counts_as / 4)), abs=1e-9)


def test_range_from_zero_still_leaves_predictions_positive() -> None:
    found = metrics_of([[0.0, -1.0]], [[4.0, 4.0]], replace(EVERYWHERE, min_depth=0.0))
    assert found.log10 == pytest.approx(math.log10(4e6), abs=1e-9)


def test_prediction_of_another_size_is_resized_bilinearly_corners_aligned() -> None:
    # Between 1 and 3 on both axes lie 2s.
    found = metrics_of([[1.0, 3.0], [3.0, 5.0]], [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0], [3.0, 4.0, 5.0]])
    assert found == Metrics(0, 0, 0, 1, 1, 1, 0, 0, 0)


def test_standard_deviation_of_another_size_is_resized_too() -> None:
    truth = np.arange(1.0, 10.0).reshape(3, 3) / 2
    found = score(prediction_of(truth + 0.5, std=[[0.25, 0.25], [1.0, 1.0]]), sample_of(truth), EVERYWHERE).uncertainty
    assert found is not None
    assert found.coverage1 == pytest.approx(2 / 3)  # rows of 0.25, 0.625 and 1
    assert found.coverage2 == 1


# ---------------------------------------------------------------------------------------------------- alignment


@pytest.mark.parametrize("factor", [0.125, 0.5, 4.0])
def test_median_alignment_undoes_a_factor_exactly(factor: float) -> None:
    truth = np.random.default_rng(0).integers(1, 160, size=(9, 9)) / 16
    truth = np.where(truth < 10, truth, 0)
    assert metrics_of(factor * truth, truth, MEDIAN) == Metrics(0, 0, 0, 1, 1, 1, 0, 0, 0)
    assert metrics_of(factor * truth, truth).rel > 0.3


def test_median_is_that_of_the_scored_pixels() -> None:
    # Of all pixels it would be 8.
    found = metrics_of([[1.0, 2.0, 3.0, 8.0, 8.0, 8.0, 8.0]], [[2.0, 4.0, 6.0, 0.0, 0.0, 0.0, 0.0]], MEDIAN)
    assert found.rel == 0


def test_median_alignment_clips_after_it() -> None:
    # 40 m is beyond the cap before the factor, not after.
    assert metrics_of([[8.0, 16.0, 40.0]], [[1.0, 2.0, 5.0]], MEDIAN).rel == 0


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (3.0, 0.0), (0.25, 2.0), (200.0, -5.0)])
def test_disparity_alignment_undoes_scale_and_shift_of_relative_depth(scale: float, shift: float) -> None:
    truth = np.random.default_rng(0).uniform(0.5, 9.5, size=(20, 30)).astype(np.float32)
    relative = scale / truth + shift
    found = metrics_of(relative, truth, DISPARITY, relative=True)
    assert found.rel < 1e-5
    assert found.delta1 == 1


def test_disparity_alignment_of_metric_depth_undoes_scale_and_shift_of_its_inverse() -> None:
    truth = np.random.default_rng(0).uniform(0.5, 9.5, size=(20, 30)).astype(np.float32)
    depth = 1 / (0.5 / truth + 0.25)
    assert metrics_of(depth, truth, DISPARITY).rel < 1e-5
    assert metrics_of(depth, truth).rel > 0.1


def test_disparity_alignment_is_least_squares_over_the_scored_pixels() -> None:
    rng = np.random.default_rng(0)
    truth = rng.uniform(1, 9, size=(8, 8))
    truth[:2] = 0
    relative = rng.uniform(0, 1, size=(8, 8)).astype(np.float32)
    sample = sample_of(truth)
    known = scored_pixels(sample, EVERYWHERE)
    depth = aligned_depth(Prediction(relative, relative=True), sample.target[0].numpy(), known, DISPARITY)
    inverse = 1 / sample.target[0].numpy()[known].astype(np.float64)
    design = np.stack([relative[known].astype(np.float64), np.ones(known.sum())], axis=1)
    expected = design @ np.linalg.lstsq(design, inverse, rcond=None)[0]
    np.testing.assert_allclose(1 / depth[known], expected, rtol=1e-9)


def test_disparity_alignment_of_one_value_everywhere_is_the_mean_inverse_depth() -> None:
    found = aligned_depth(
        prediction_of([[0.5, 0.5]], relative=True), np.array([[1.0, 4.0]]), np.array([[True, True]]), DISPARITY
    )
    np.testing.assert_allclose(found, 1 / 0.625)


def test_disparity_of_zero_or_less_is_as_far_as_the_cap() -> None:
    # The line through (2, 1 / 1) and (1, 1 / 2) is 0 at 0, and below it beyond.
    truth = np.array([[1.0, 2.0, 0.0, 0.0]])
    found = aligned_depth(prediction_of([[2.0, 1.0, 0.0, -3.0]], relative=True), truth, truth > 0, DISPARITY)
    np.testing.assert_allclose(found, [[1.0, 2.0, 10.0, 10.0]])


@pytest.mark.parametrize("factor", [1e-3, 0.5, 2.0, 1e3])
def test_depth_that_is_no_number_does_not_move_the_median_whatever_the_unit(factor: float) -> None:
    truth = np.array([[1.0, 2.0, 4.0, 5.0, 6.0, 7.0]])
    depth = [[1 / factor, 2 / factor, 4 / factor, math.nan, math.inf, -math.inf]]
    found = aligned_depth(prediction_of(depth), truth, truth > 0, MEDIAN)
    np.testing.assert_allclose(found, [[1.0, 2.0, 4.0, 1e-3, 10, 1e-3]], rtol=1e-6)
    nothing = aligned_depth(prediction_of([[math.nan] * 6]), truth, truth > 0, MEDIAN)
    np.testing.assert_allclose(nothing, [[1e-3] * 6])


def test_disparity_that_is_no_number_is_replaced_before_the_alignment() -> None:
    # It halves and adds 0.2: of 1 / 1e-3 and 0 it makes 500.2 and 0.2.
    truth = np.array([[1.0, 2.0, 4.0, 0.0, 0.0, 0.0]])
    relative = [[1.6, 0.6, 0.1, math.nan, math.inf, -math.inf]]
    found = aligned_depth(prediction_of(relative, relative=True), truth, truth > 0, DISPARITY)
    np.testing.assert_allclose(found, [[1.0, 2.0, 4.0, 1 / 500.2, 1 / 500.2, 5.0]], rtol=1e-5)  # float32 has no 1.6


def test_depth_that_is_no_number_counts_as_nearest_where_its_inverse_is_aligned() -> None:
    truth = np.array([[1.0, 2.0, 4.0, 0.0, 0.0]])
    found = aligned_depth(prediction_of([[1.0, 2.0, 4.0, math.nan, math.inf]]), truth, truth > 0, DISPARITY)
    np.testing.assert_allclose(found, [[1.0, 2.0, 4.0, 1e-3, 10.0]])


@pytest.mark.parametrize("protocol", [MEDIAN, DISPARITY], ids=["median", "disparity"])
@pytest.mark.parametrize("hole", [0.0, math.nan, math.inf, -1.0])
def test_holes_do_not_decide_on_the_alignment_of_the_others(hole: float, protocol: Protocol) -> None:
    truth = np.array([[1.0, 2.0, 4.0, 2.0, 2.0]])
    found = aligned_depth(prediction_of([[2.0, 4.0, 8.0, hole, hole]]), truth, truth > 0, protocol)
    counts_as = 10.0 if hole == math.inf else 1e-3
    np.testing.assert_allclose(found, [[1.0, 2.0, 4.0, counts_as, counts_as]], rtol=1e-5)
    nothing = aligned_depth(prediction_of([[hole] * 5]), truth, truth > 0, protocol)
    assert np.isfinite(nothing).all()


def test_holes_that_are_scored_are_counted() -> None:
    truth = [[1.0, 2.0, 4.0, 0.0, 0.0]]
    depth = [[1.0, 0.0, math.nan, 0.0, 3.0]]
    assert score(prediction_of(depth), sample_of(truth), EVERYWHERE).n_holes == 2
    relative = score(prediction_of(depth, relative=True), sample_of(truth), DISPARITY)
    assert relative.n_holes == 1  # a disparity of 0 is far away
    assert Score.from_json(relative.to_json()) == relative
    assert score(prediction_of([[1.0] * 5]), sample_of(truth), EVERYWHERE).n_holes == 0


def test_disparity_that_is_no_number_counts_as_nearest_and_minus_infinity_as_farthest() -> None:
    truth = np.array([[1.0, 2.0, 4.0, 0.0, 0.0, 0.0]])
    relative = [[1.0, 0.5, 0.25, math.nan, math.inf, -math.inf]]
    found = aligned_depth(prediction_of(relative, relative=True), truth, truth > 0, DISPARITY)
    np.testing.assert_allclose(found, [[1.0, 2.0, 4.0, 1e-3, 1e-3, 10.0]])


def test_metric_depth_of_a_few_centimetres_is_aligned_like_any_other() -> None:
    assert metrics_of([[0.025, 0.05, 0.1]], [[1.0, 2.0, 4.0]], DISPARITY).rel == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("protocol", [EVERYWHERE, MEDIAN], ids=["none", "median"])
def test_relative_depth_that_is_not_aligned_is_an_error_that_says_how(protocol: Protocol) -> None:
    with pytest.raises(InputError, match="--align disparity"):
        score(prediction_of([[0.5]], relative=True), sample_of([[2.0]]), protocol)


# ---------------------------------------------------------------------------------------------------- the rest


def test_ranges_of_depth_sum_to_the_total() -> None:
    protocol = Protocol("all", max_depth=1000.0)
    rng = np.random.default_rng(0)
    truth = np.exp(rng.uniform(math.log(0.1), math.log(900), size=(40, 40))).astype(np.float32)
    depth = truth * rng.uniform(0.5, 2, size=truth.shape)
    found = score(prediction_of(depth), sample_of(truth), protocol)
    assert found.sums is not None
    assert all(part.n_pixels for part in found.ranges)
    total = add_sums(found.ranges)
    assert total.n_pixels == found.sums.n_pixels == 1600
    assert (total.delta1, total.delta2, total.delta3) == (found.sums.delta1, found.sums.delta2, found.sums.delta3)
    for name, value in dataclasses.asdict(total).items():
        assert value == pytest.approx(getattr(found.sums, name), rel=1e-12), name


def test_range_has_its_lower_edge_and_not_its_upper() -> None:
    truth = np.array([list(RANGES[1:-1])])
    found = score(prediction_of(1.5 * truth), sample_of(truth), Protocol("all", max_depth=1000.0))
    assert [part.n_pixels for part in found.ranges] == [0, *[1] * (len(RANGES) - 2)]
    for (low, high), part in zip(itertools.pairwise(RANGES), found.ranges, strict=True):
        here = truth[(truth >= low) & (truth < high)]
        assert part == pixel_sums(np.minimum(1.5 * here, 1000.0), here)


def test_score_says_of_what_it_is() -> None:
    sample = sample_of([[2.0]], domain="attic", name="image/1.jpg")
    found = score(prediction_of([[2.0]])._replace(domain="indoor"), sample, EVERYWHERE)
    assert (found.name, found.domain, found.routed) == ("image/1.jpg", "attic", "indoor")


def test_uncertainty_is_judged_where_there_is_one() -> None:
    sample = photo((30, 40))
    depth = 1.25 * sample.target[0].numpy()
    assert score(prediction_of(depth), sample, EVERYWHERE).uncertainty is None
    found = score(prediction_of(depth, std=0.3 * depth), sample, EVERYWHERE).uncertainty
    assert found is not None
    assert (found.coverage1, found.coverage2) == (1, 1)


@pytest.mark.parametrize("protocol", [MEDIAN, DISPARITY], ids=["median", "disparity"])
def test_uncertainty_of_a_depth_that_is_aligned_is_not_judged(protocol: Protocol) -> None:
    # The standard deviation was of the depth before.
    sample = photo((30, 40))
    depth = 0.5 * sample.target[0].numpy()
    assert score(prediction_of(depth, std=depth), sample, protocol).uncertainty is None


def test_edges_are_those_of_the_depth_that_is_scored() -> None:
    truth = np.where(np.arange(40) < 20, 2.0, 4.0) * np.ones((120, 1))
    sharp = score(prediction_of(truth), sample_of(truth), EVERYWHERE)
    flat = score(prediction_of(np.full_like(truth, 3.0)), sample_of(truth), EVERYWHERE)
    assert (sharp.boundary_f1, flat.boundary_f1) == (1, 0)
    assert score(prediction_of(truth[:50]), sample_of(truth[:50]), EVERYWHERE).boundary_f1 is None  # 50 pairs


def test_edges_of_pixels_that_are_not_scored_do_not_count() -> None:
    truth = np.where(np.arange(40) < 20, 2.0, 12.0) * np.ones((120, 1))  # beyond 10 m on the right
    assert score(prediction_of(truth), sample_of(truth), EVERYWHERE).boundary_f1 is None


def awkward_scores() -> list[Score]:
    sample = photo((130, 40))
    depth = sample.target[0].numpy() * 1.1
    full = score(prediction_of(depth, std=depth / 7)._replace(domain="outdoor"), sample, EVERYWHERE)
    assert None not in (full.routed, full.sums, full.uncertainty, full.boundary_f1)
    return [full, replace(full, routed=None, uncertainty=None, boundary_f1=None), Score("b", "", None, None)]


@pytest.mark.parametrize("index", [0, 1, 2], ids=["everything", "no uncertainty and no edges", "nothing"])
def test_score_comes_back_from_json_as_it_was(index: int) -> None:
    found = awkward_scores()[index]
    assert Score.from_json(json.loads(json.dumps(found.to_json()))) == found
