"""Scores by hand on known arrays, and the prediction that is scored."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from zoedepth.config import ModelConfig
from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample
from zoedepth.evaluation.evaluate import evaluate, score
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Protocol
from zoedepth.metrics import mean_metrics
from zoedepth.model.zoedepth import ZoeDepth

EVERYWHERE = Protocol("everywhere", max_depth=10.0)


def sample_of(truth: list[list[float]] | np.ndarray, *, domain: str = "indoor") -> Sample:
    """A grey photo with this depth, metres; 0 is unknown."""
    target = torch.tensor(np.asarray(truth), dtype=torch.float32)[None]
    return Sample(torch.full((3, *target.shape[1:]), 0.5), target, target > 0, "depth", domain, "photo.jpg")


def depth_of(values: list[list[float]]) -> np.ndarray:
    return np.array(values, dtype=np.float32)


def photo(size: tuple[int, int], *, seed: int = 0, domain: str = "indoor") -> Sample:
    """A photo of 8 bits and depth (1 to 9 m) at random."""
    rng = np.random.default_rng(seed)
    sample = sample_of(rng.uniform(1, 9, size=size), domain=domain)
    values = rng.integers(0, 256, size=(3, *size))
    return dataclasses.replace(sample, image=torch.tensor(values / 255, dtype=torch.float32))


# ---------------------------------------------------------------------------------------------------- score


def test_prediction_a_quarter_too_far() -> None:
    metrics = score(depth_of([[2.5, 5.0]]), sample_of([[2.0, 4.0]]), EVERYWHERE)
    assert metrics is not None
    assert metrics.rel == pytest.approx(0.25)
    assert metrics.rmse == pytest.approx(math.sqrt((0.5**2 + 1.0**2) / 2))
    assert metrics.log10 == pytest.approx(math.log10(1.25))
    # A ratio of 1.25 is not below 1.25, but below 1.25 squared.
    assert (metrics.delta1, metrics.delta2, metrics.delta3) == (0, 1, 1)


def test_perfect_prediction() -> None:
    metrics = score(depth_of([[2.0, 4.0]]), sample_of([[2.0, 4.0]]), EVERYWHERE)
    assert metrics is not None
    assert dataclasses.astuple(metrics) == (0, 0, 0, 1, 1, 1)


def test_mixed_errors_of_four_pixels() -> None:
    metrics = score(depth_of([[1.2, 1.0], [2.8, 8.0]]), sample_of([[1.0, 1.5], [4.0, 4.0]]), EVERYWHERE)
    assert metrics is not None
    # Ratios 1.2, 1.5, 1.43, 2 against 1.25, 1.5625, 1.953.
    assert (metrics.delta1, metrics.delta2, metrics.delta3) == (0.25, 0.75, 0.75)
    assert metrics.rel == pytest.approx((0.2 + 1 / 3 + 0.3 + 1.0) / 4)
    assert metrics.rmse == pytest.approx(math.sqrt((0.04 + 0.25 + 1.44 + 16) / 4), rel=1e-6)


def test_unknown_pixels_and_those_beyond_the_range_are_not_scored() -> None:
    truth = [[2.0, 0.0, 10.0, 30.0, 1e-3, 5e-4]]
    metrics = score(depth_of([[3.0, 9.0, 9.0, 9.0, 9.0, 9.0]]), sample_of(truth), EVERYWHERE)
    assert metrics is not None
    assert metrics.rel == pytest.approx(0.5)


def test_known_is_what_the_mask_says_not_the_depth() -> None:
    sample = sample_of([[2.0, 2.0]])
    sample = dataclasses.replace(sample, mask=torch.tensor([[[True, False]]]))
    metrics = score(depth_of([[3.0, 9.0]]), sample, EVERYWHERE)
    assert metrics is not None
    assert metrics.rel == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("prediction", "counts_as"),
    [(100.0, 10.0), (math.inf, 10.0), (math.nan, 1e-3), (-math.inf, 1e-3), (-1.0, 1e-3), (0.0, 1e-3)],
)
def test_prediction_counts_as_the_nearest_in_range_and_nan_as_near(prediction: float, counts_as: float) -> None:
    metrics = score(depth_of([[prediction]]), sample_of([[4.0]]), EVERYWHERE)
    assert metrics is not None
    assert metrics.rel == pytest.approx(abs(counts_as - 4) / 4)
    assert metrics.log10 == pytest.approx(abs(math.log10(counts_as / 4)), rel=1e-5)


@pytest.mark.parametrize(
    ("protocol", "size", "inside"),
    [
        (INDOOR, (480, 640), (slice(45, 471), slice(41, 601))),
        (OUTDOOR, (352, 1216), (slice(143, 349), slice(43, 1172))),
    ],
    ids=["eigen", "garg"],
)
def test_errors_outside_the_crop_do_not_count(
    protocol: Protocol, size: tuple[int, int], inside: tuple[slice, slice]
) -> None:
    truth = np.full(size, 4.0)
    depth = np.full(size, 9.0, dtype=np.float32)
    depth[inside] = 5.0
    metrics = score(depth, sample_of(truth), protocol)
    assert metrics is not None
    assert metrics.rel == pytest.approx(0.25)
    # And every pixel inside does: one that is 1 m worse adds 0.25 / the number of them.
    depth[inside[0].start, inside[1].start] = 6.0
    n_pixels = (inside[0].stop - inside[0].start) * (inside[1].stop - inside[1].start)
    worse = score(depth, sample_of(truth), protocol)
    assert worse is not None
    assert worse.rel - metrics.rel == pytest.approx(0.25 / n_pixels, rel=1e-3)


def test_photo_without_a_scored_pixel_has_no_score() -> None:
    assert score(depth_of([[2.0]]), sample_of([[0.0]]), EVERYWHERE) is None
    assert score(depth_of([[2.0]]), sample_of([[20.0]]), EVERYWHERE) is None
    assert score(np.full((40, 40), 2.0, dtype=np.float32), sample_of(np.full((40, 40), 2.0)), INDOOR) is None


def test_mean_is_over_photos_not_pixels() -> None:
    one = score(depth_of([[3.0]]), sample_of([[2.0]]), EVERYWHERE)
    many = score(depth_of([[2.0] * 9]), sample_of([[2.0] * 9]), EVERYWHERE)
    assert one is not None
    assert many is not None
    assert mean_metrics([one, many]).rel == pytest.approx(0.25)


# ---------------------------------------------------------------------------------------------------- prediction


@pytest.fixture
def outdoor_model(tiny_model: ZoeDepth) -> ZoeDepth:
    """Takes every photo, and its mirror image, for an outdoor one."""
    with torch.no_grad():
        tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([0.0, 1000.0]))
    return tiny_model


def error_against(model: ZoeDepth, sample: Sample, truth: torch.Tensor, *, flip_average: bool) -> float:
    """REL of the model's prediction against this depth."""
    protocol = Protocol("everywhere", max_depth=1e3, flip_average=flip_average)
    target = truth.reshape(1, *sample.target.shape[1:])
    (result,) = evaluate(model, [dataclasses.replace(sample, target=target, mask=target > 0)], protocol)
    assert result.metrics is not None
    return result.metrics.rel


def test_prediction_is_that_of_the_original_evaluation(outdoor_model: ZoeDepth) -> None:
    sample = photo((50, 90))
    # Resized to multiples of 32 near 64 in height, corners aligned; averaged with the mirrored one at that size;
    # resized to the photo's size, corners aligned.
    pixels = F.interpolate(sample.image[None], (64, 128), mode="bilinear", align_corners=True)
    with torch.no_grad():
        output = outdoor_model(pixels)
        mirrored = outdoor_model(pixels.flip(-1), domain=output.domain).depth.flip(-1)
    averaged, plain = (
        F.interpolate(depth, (50, 90), mode="bilinear", align_corners=True)
        for depth in ((output.depth + mirrored) / 2, output.depth)
    )
    assert error_against(outdoor_model, sample, averaged, flip_average=True) < 1e-5
    assert error_against(outdoor_model, sample, plain, flip_average=False) < 1e-5
    assert error_against(outdoor_model, sample, plain, flip_average=True) > 1e-4


def test_antialiased_model_sees_fine_stripes_as_grey(tiny_config: ModelConfig) -> None:
    torch.manual_seed(0)
    sharp = ZoeDepth(tiny_config).eval()
    smooth = ZoeDepth(dataclasses.replace(tiny_config, antialias=True)).eval()
    smooth.load_state_dict(sharp.state_dict())
    grey = sample_of(np.full((512, 512), 1.0))
    grey = dataclasses.replace(grey, image=torch.full((3, 512, 512), 128 / 255))
    stripes = dataclasses.replace(grey, image=(torch.arange(512) % 2).expand(3, 512, 512).float())

    def difference(model: ZoeDepth) -> float:
        with torch.no_grad():
            truth = model(torch.full((1, 3, 64, 64), 128 / 255)).depth
        truth = F.interpolate(truth, (512, 512), mode="bilinear", align_corners=True)
        assert error_against(model, grey, truth, flip_average=False) < 1e-3
        return error_against(model, stripes, truth, flip_average=False)

    assert difference(smooth) < 0.2 * difference(sharp)


def test_kitti_photos_are_cut_to_their_bottom_centre_first(tiny_model: ZoeDepth) -> None:
    sample = photo((375, 1242), domain="outdoor")
    cropped = kitti_crop()(sample, np.random.default_rng(0))
    protocol = dataclasses.replace(OUTDOOR, kitti_crop=False)
    (ours,) = evaluate(tiny_model, [sample], OUTDOOR)
    (expected,) = evaluate(tiny_model, [cropped], protocol)
    (other,) = evaluate(tiny_model, [sample], protocol)
    assert ours == expected
    assert ours != other


def test_scores_come_in_order_with_names_and_the_domain_of_the_head(outdoor_model: ZoeDepth) -> None:
    samples = [
        dataclasses.replace(photo((64, 64), seed=seed), name=f"{seed}.jpg", domain="indoor") for seed in range(3)
    ]
    samples[1] = dataclasses.replace(samples[1], mask=samples[1].mask & False)
    scores = list(evaluate(outdoor_model, samples, EVERYWHERE))

    assert [score.name for score in scores] == ["0.jpg", "1.jpg", "2.jpg"]
    assert [score.metrics is None for score in scores] == [False, True, False]
    assert [score.domain for score in scores] == ["outdoor"] * 3
