import math

import pytest
import torch
from torch import nn

import zoedepth.model.heads.probability
from zoedepth.model.heads.probability import (
    BinDistribution,
    LogBinomial,
    Softmax,
    build_probability,
    convolved,
    log_binomial,
    log_binomial_coefficients,
)
from zoedepth.model.upsample import upsample


@pytest.mark.parametrize("n_bins", [2, 64, 256])
def test_coefficients_are_finite_and_symmetric(n_bins: int):
    coefficients = log_binomial_coefficients(n_bins)
    assert coefficients.shape == (n_bins,)
    assert coefficients.isfinite().all()
    assert torch.allclose(coefficients, coefficients.flip(0), atol=1e-4)


def test_coefficients_are_computed_in_double_precision():
    def times_log(x: float) -> float:
        return x * math.log(x)

    expected = [times_log(255) - times_log(k + 1e-7) - times_log(255 - k + 1e-7) for k in range(256)]
    assert log_binomial_coefficients(256).tolist() == pytest.approx(expected, abs=2e-5)


def test_extremes_of_q_choose_the_first_and_the_last_bin():
    p = log_binomial(torch.tensor([0.0, 1.0]).view(2, 1, 1, 1), torch.ones(2, 1, 1, 1), log_binomial_coefficients(16))
    assert p[:, :, 0, 0].argmax(dim=1).tolist() == [0, 15]
    assert p[0, 0].item() > 0.98
    assert p[1, 15].item() > 0.98


def test_mirrored_q_mirrors_the_bins():
    coefficients = log_binomial_coefficients(16)
    t = torch.full((1, 1, 1, 1), 0.7)
    left, right = (log_binomial(torch.full((1, 1, 1, 1), q), t, coefficients) for q in (0.3, 0.7))
    assert torch.allclose(left, right.flip(1), atol=1e-5)


def test_extremes_have_finite_values_and_gradients():
    q = torch.tensor([0.0, 1e-6, 0.5, 1.0]).view(4, 1, 1, 1).requires_grad_()
    t = torch.full((4, 1, 1, 1), 0.0212, requires_grad=True)
    p = log_binomial(q, t, log_binomial_coefficients(64))
    (p * torch.arange(64.0).view(1, 64, 1, 1)).sum().backward()
    assert p.isfinite().all()
    assert q.grad.isfinite().all()
    assert t.grad.isfinite().all()


def test_half_precision_input_is_computed_in_float32():
    q, t = torch.full((1, 1, 2, 2), 0.25), torch.full((1, 1, 2, 2), 0.5)
    coefficients = log_binomial_coefficients(64)
    exact = log_binomial(q, t, coefficients)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        half = log_binomial(q.bfloat16(), t.bfloat16(), coefficients)
    assert half.dtype == torch.float32
    assert torch.equal(half, exact)  # both numbers are exact in bfloat16


def test_temperature_stays_between_its_bounds():
    """Whatever comes in: the sharpest distribution is that of the lowest t, the flattest that of the highest."""
    torch.manual_seed(0)
    predictor = LogBinomial(8, 16, bottleneck_factor=2, min_temperature=0.5, max_temperature=2.0)
    p = predictor([100 * torch.randn(50, 8, 1, 1)], torch.ones(1, 1, 1, 1)).probability.flatten(1)
    coefficients = log_binomial_coefficients(16)
    q = torch.linspace(0, 1, 1001).view(-1, 1, 1, 1)
    peak = {t: log_binomial(q, torch.full_like(q, t), coefficients).flatten(1).max(dim=1).values for t in (0.5, 2.0)}
    flattest, sharpest = peak[2.0].min(), peak[0.5].max()
    assert (p.max(dim=1).values >= flattest - 1e-3).all()
    assert (p.max(dim=1).values <= sharpest + 1e-3).all()


@torch.no_grad()
def test_pairs_are_kept_from_zero_by_the_released_epsilon():
    """Numbers of 2e-4 and 0, with 1e-4 added to each: three quarters of the range, for q and for t."""
    predictor = LogBinomial(8, 16, bottleneck_factor=2, min_temperature=0.5, max_temperature=2.0)
    predictor.mlp[2].weight.zero_()
    small = math.log(math.expm1(2e-4))  # softplus makes 2e-4 of it
    predictor.mlp[2].bias.copy_(torch.tensor([small, -40.0, small, -40.0]))
    found = predictor([torch.rand(1, 8, 1, 1)], torch.ones(1, 1, 1, 1)).probability
    q, t = torch.full((1, 1, 1, 1), 0.75), torch.full((1, 1, 1, 1), 0.5 + 1.5 * 0.75)
    assert torch.allclose(found, log_binomial(q, t, log_binomial_coefficients(16)), atol=1e-4)


@pytest.mark.parametrize("factor", [2, 4])
def test_hidden_width_is_the_input_width_divided_by_the_factor(factor: int):
    binomial = LogBinomial(33, 8, bottleneck_factor=factor, min_temperature=0.1, max_temperature=5.0)
    softmax = Softmax(33, 8, bottleneck_factor=factor)
    for predictor in (binomial, softmax):
        assert next(predictor.parameters()).shape[:2] == (33 // factor, 33)


@torch.no_grad()
def test_predictors_apply_their_whole_mlp_to_the_stacked_maps():
    torch.manual_seed(0)
    maps = [3 * torch.randn(2, 5, 4, 6), 3 * torch.randn(2, 3, 2, 3)]
    stack = torch.cat([maps[0], upsample(maps[1], (4, 6))], dim=1)
    softmax = Softmax(8, 16, bottleneck_factor=2)
    found = softmax(maps, torch.ones(1, 16, 1, 1)).probability
    torch.testing.assert_close(found, softmax.mlp(stack).softmax(dim=1), rtol=1e-4, atol=1e-6)
    binomial = LogBinomial(8, 16, bottleneck_factor=2, min_temperature=0.5, max_temperature=2.0)
    pairs = binomial.mlp(stack) + 1e-4
    q, t = pairs[:, 0:1] / pairs[:, 0:2].sum(1, keepdim=True), pairs[:, 2:3] / pairs[:, 2:4].sum(1, keepdim=True)
    found = binomial(maps, torch.ones(1, 16, 1, 1)).probability
    expected = log_binomial(q, 0.5 + 1.5 * t, log_binomial_coefficients(16))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


def test_softmax_is_free_to_have_two_modes():
    torch.manual_seed(0)
    predictor = Softmax(8, 16, bottleneck_factor=1)
    p = predictor([10 * torch.randn(20, 8, 1, 1)], torch.ones(1, 1, 1, 1)).probability.flatten(1)
    assert torch.allclose(p.sum(dim=1), torch.ones(20), atol=1e-5)
    changes = p.diff(dim=1).sign().diff(dim=1).abs().gt(0).sum(dim=1)
    assert (changes > 1).any()


def test_coefficients_are_no_weights():
    """They follow from the number of bins, so files do not carry them."""
    predictor = LogBinomial(8, 16, bottleneck_factor=2, min_temperature=0.1, max_temperature=5.0)
    assert all(name.startswith("mlp.") for name in predictor.state_dict())


@torch.no_grad()
@pytest.mark.parametrize("bias", [True, False])
def test_convolution_of_maps_is_that_of_their_stack(bias: bool):
    torch.manual_seed(0)
    conv = nn.Conv2d(8, 3, 1, bias=bias)
    maps = [torch.randn(2, 5, 4, 6), torch.randn(2, 3, 2, 3)]
    stack = torch.cat([maps[0], upsample(maps[1], (4, 6))], dim=1)
    torch.testing.assert_close(convolved(conv, maps), conv(stack))


def test_kinds_of_probability():
    options = {"bottleneck_factor": 2, "min_temperature": 0.1, "max_temperature": 5.0}
    assert isinstance(build_probability("softmax", 8, 16, **options), Softmax)
    assert isinstance(build_probability("log-binomial", 8, 16, **options), LogBinomial)


# --- distributions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n_weights", "bias"), [(0, False), (1, False), (1, True), (2, False), (2, True)])
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (6, 4)])
def test_distribution_by_definition(n_weights: int, bias: bool, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch):
    """Logits are the maps, or products that the images share or not; with gradients at once, without in bands."""
    torch.manual_seed(0)
    maps = torch.randn(2, 3 if n_weights else 5, 6, 4, dtype=torch.float64)
    weight = torch.randn(n_weights, 5, 3, dtype=torch.float64) if n_weights else None
    shift = torch.randn(n_weights, 5, dtype=torch.float64) if bias else None
    centers = torch.rand(2, 5, *size, dtype=torch.float64)
    logits = maps if weight is None else torch.einsum("bkt,bthw->bkhw", weight.expand(2, -1, -1), maps)
    probability = (logits if shift is None else logits + shift[:, :, None, None]).softmax(dim=1)
    places = upsample(centers, (6, 4))
    mean = (probability * places).sum(dim=1, keepdim=True)
    std = (probability * (places - mean).square()).sum(dim=1, keepdim=True).sqrt()

    distribution = BinDistribution(maps, weight, shift, centers)
    torch.testing.assert_close(distribution.probability, probability)
    torch.testing.assert_close(distribution.bin_centers, places)
    for gradients in (True, False):
        for band in (1, 80, 2**19):
            monkeypatch.setattr(zoedepth.model.heads.probability, "_BAND", band)
            with torch.set_grad_enabled(gradients):
                torch.testing.assert_close(distribution.mean(), mean)
                torch.testing.assert_close(distribution.mean_and_std(), (mean, std))


def test_a_distribution_of_one_bin_has_a_gradient_all_the_same():
    """Its deviation is 0, whose root has none: a training that asks for the deviation ended with nan."""
    maps = torch.tensor([1000.0, 0.0, -1000.0]).view(1, 3, 1, 1).requires_grad_()
    centers = torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1).requires_grad_()
    mean, std = BinDistribution(maps, None, None, centers).mean_and_std()
    assert (mean.item(), std.item()) == (1.0, pytest.approx(1e-6))
    (mean + std).sum().backward()
    for x in (maps, centers):
        assert x.grad is not None
        assert x.grad.isfinite().all()


@pytest.mark.parametrize(
    ("gradients", "band", "n_bands"), [(True, 80, 1), (False, 2**19, 1), (False, 80, 3), (False, 1, 6)]
)
def test_bands_are_as_large_as_they_may_be_and_gradients_have_none(
    gradients: bool, band: int, n_bands: int, monkeypatch: pytest.MonkeyPatch
):
    """A row has 2 x 4 pixels of 5 bins: two rows fit in 80 numbers, and a band has at least one."""
    monkeypatch.setattr(zoedepth.model.heads.probability, "_BAND", band)
    sizes = []
    monkeypatch.setattr(
        zoedepth.model.heads.probability, "expected_depth", lambda p, c: sizes.append(p.numel()) or (p * c).sum(dim=-1)
    )
    with torch.set_grad_enabled(gradients):
        BinDistribution(torch.randn(2, 5, 6, 4), None, None, torch.rand(2, 5, 2, 3)).mean()
    assert sizes == [240 // n_bands] * n_bands
