import math
import warnings

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.metrics import Metrics, Sums, add_sums, compute_metrics, mean_metrics, pixel_sums, pooled_metrics


def test_metrics_by_hand():
    found = compute_metrics(np.array([1.0, 3.0, 8.0]), np.array([2.0, 2.0, 8.0]))
    # rel (1/2 + 1/2 + 0) / 3; rmse sqrt((1 + 1 + 0) / 3); log10 (log10 2 + log10 1.5) / 3; ratios 2, 1.5, 1
    assert found.rel == pytest.approx(1 / 3)
    assert found.rmse == pytest.approx(math.sqrt(2 / 3))
    assert found.log10 == pytest.approx((math.log10(2) + math.log10(1.5)) / 3)
    assert found.delta1 == pytest.approx(1 / 3)
    assert found.delta2 == pytest.approx(2 / 3)  # 1.5 < 1.5625
    assert found.delta3 == pytest.approx(2 / 3)  # 2 > 1.953125
    assert found.sq_rel == pytest.approx((1 / 2 + 1 / 2 + 0) / 3)
    logs = [math.log(1 / 2), math.log(3 / 2), 0.0]
    mean = sum(logs) / 3
    assert found.rmse_log == pytest.approx(math.sqrt(sum(x**2 for x in logs) / 3))
    assert found.silog == pytest.approx(100 * math.sqrt(sum((x - mean) ** 2 for x in logs) / 3))


def test_perfect_prediction():
    truth = np.linspace(0.5, 9, 50, dtype=np.float32)
    assert compute_metrics(truth, truth) == Metrics(0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("ratio", "deltas"), [(1.25, (0, 1, 1)), (1.2499, (1, 1, 1)), (1.5625, (0, 0, 1)), (1.953125, (0, 0, 0))]
)
def test_thresholds_are_strict_and_the_same_on_both_sides(ratio: float, deltas: tuple[int, int, int]):
    truth = np.array([4.0])
    for prediction in (truth * ratio, truth / ratio):
        found = compute_metrics(prediction, truth)
        assert (found.delta1, found.delta2, found.delta3) == deltas


def test_rel_is_relative_to_the_truth():
    assert compute_metrics(np.array([1.0]), np.array([4.0])).rel == pytest.approx(0.75)
    assert compute_metrics(np.array([4.0]), np.array([1.0])).rel == pytest.approx(3.0)


def test_sums_are_in_float64():
    """A million equal errors of float32 numbers do not drift."""
    truth = np.full(1_000_000, 10.0, dtype=np.float32)
    found = compute_metrics(np.full_like(truth, 11.0), truth)
    assert found.rel == pytest.approx(0.1, rel=1e-12)
    assert found.rmse == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("which", ["prediction", "truth"])
def test_values_that_are_no_depth_are_an_error(which: str, bad: float):
    values = {"prediction": np.ones(3), "truth": np.ones(3)}
    values[which][1] = bad
    with pytest.raises(InputError, match=which):
        compute_metrics(values["prediction"], values["truth"])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("truth", [np.ones(0), np.ones(4)])
def test_no_pixels_or_another_number_of_them_is_an_error(truth: np.ndarray):
    with pytest.raises(InputError, match="pixel"):
        compute_metrics(np.ones(len(truth) % 4), truth)


def test_mean_is_over_images_not_pixels():
    one, many = compute_metrics(np.array([2.0]), np.array([1.0])), compute_metrics(np.ones(99), np.ones(99))
    found = mean_metrics([one, many])
    assert found.rel == pytest.approx(0.5)
    assert found.rmse == pytest.approx(0.5)
    assert found.delta1 == pytest.approx(0.5)
    assert found.log10 == pytest.approx(math.log10(2) / 2)


def test_mean_of_no_images_is_an_error():
    with pytest.raises(InputError, match="no image"):
        mean_metrics([])


def test_prediction_scaled_by_one_factor_has_the_errors_it_must():
    truth = np.random.default_rng(0).uniform(0.5, 9, 1000)
    found = compute_metrics(1.25 * truth, truth)
    assert found.rel == pytest.approx(0.25, abs=1e-12)
    assert found.rmse == pytest.approx(0.25 * math.sqrt(np.mean(truth**2)), abs=1e-12)
    assert found.log10 == pytest.approx(math.log10(1.25), abs=1e-12)
    assert found.rmse_log == pytest.approx(math.log(1.25), abs=1e-12)
    assert found.silog == pytest.approx(0, abs=1e-9)
    assert (found.delta2, found.delta3) == (1, 1)


def test_pooled_is_over_pixels_not_images():
    one, many = pixel_sums(np.array([2.0]), np.array([1.0])), pixel_sums(np.ones(99), np.ones(99))
    found = pooled_metrics([one, many])
    assert found.rel == pytest.approx(0.01)
    assert found.rmse == pytest.approx(0.1)


def test_pooled_equals_the_metrics_of_all_pixels_and_does_not_depend_on_the_order():
    rng = np.random.default_rng(0)
    pairs = [(rng.uniform(0.1, 80, n), rng.uniform(0.1, 80, n)) for n in (1, 10, 333, 1000)]
    sums = [pixel_sums(*pair) for pair in pairs]
    together = compute_metrics(*(np.concatenate(column) for column in zip(*pairs, strict=True)))
    found = pooled_metrics(sums)
    for name in vars(together):
        assert getattr(found, name) == pytest.approx(getattr(together, name), rel=1e-12), name
    assert pooled_metrics(sums[::-1]) == found
    # Processes add their own first.
    assert pooled_metrics([add_sums(sums[:2]), add_sums(sums[2:])]).rel == pytest.approx(found.rel, rel=1e-15)
    assert mean_metrics([s.metrics() for s in sums]) == mean_metrics([s.metrics() for s in sums[::-1]])


def test_sums_of_one_set_are_unchanged_even_of_one_pixel():
    for n in (1, 2):
        sums = pixel_sums(np.arange(2.0, 2 + n), np.ones(n))
        assert add_sums([sums]) == sums
        assert isinstance(add_sums([sums]).n_pixels, int)


def test_sums_of_no_pixels_are_zero_and_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pixel_sums(np.ones(0), np.ones(0)) == Sums()


def test_no_pixels_have_no_metrics():
    assert add_sums([]).n_pixels == 0
    with pytest.raises(InputError, match="no pixel"):
        pooled_metrics([])
