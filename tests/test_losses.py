import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from zoedepth.errors import InputError
from zoedepth.losses import (
    domain_cross_entropy,
    gradient_error,
    log_gradient,
    mean_counted,
    normalize_robust,
    silog,
    spread,
    trimmed_absolute_error,
)
from zoedepth.losses import (
    scale_and_shift_invariant as losses_of_images,
)


def maps(*images: list[list[float]]) -> Tensor:
    """Images as (batch, 1, height, width)."""
    return torch.tensor(images)[:, None]


def scale_and_shift_invariant(prediction: Tensor, target: Tensor, mask: Tensor, **options: float) -> Tensor:
    """The mean of the images that count."""
    return mean_counted(*losses_of_images(prediction, target, mask, **options))


def random_maps(*, batch: int = 2, size: tuple[int, int] = (12, 16), seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Prediction, target and a mask of about 80 % known."""
    generator = torch.Generator().manual_seed(seed)
    prediction, target, chance = (torch.rand(batch, 1, *size, generator=generator) for _ in range(3))
    return prediction + 0.1, target + 0.1, chance < 0.8


# --- silog ------------------------------------------------------------------------------------------------------------


def test_silog_by_hand():
    # g = (0, ln 2): mean ln2 / 2, unbiased variance (ln 2)^2 / 2. 10 sqrt((ln 2)^2 (1/2 + 0.15/4)) = 5.0818
    loss = silog(maps([[1.0, 2.0]]), maps([[1.0, 1.0]]), torch.ones(1, 1, 1, 2, dtype=torch.bool))
    assert loss.item() == pytest.approx(10 * math.log(2) * math.sqrt(0.5375), rel=1e-5)
    assert loss.item() == pytest.approx(5.0818, abs=1e-3)


def test_silog_of_a_constant_factor_is_what_beta_leaves():
    # g = ln 3 everywhere: no variance, so 10 sqrt(0.15) ln 3
    target = maps([[1.0, 2.0], [3.0, 4.0]])
    loss = silog(3 * target, target, torch.ones_like(target, dtype=torch.bool))
    assert loss.item() == pytest.approx(10 * math.sqrt(0.15) * math.log(3), rel=1e-5)
    free = silog(3 * target, target, torch.ones_like(target, dtype=torch.bool), beta=0.0)
    assert free.item() == pytest.approx(0, abs=2e-3)


def test_silog_of_depths_near_zero_is_that_of_eps_more():
    # g = (ln 2, ln 3): mean (ln 6) / 2, unbiased variance (ln 1.5)^2 / 2
    loss = silog(maps([[1.0, 2.0]]), maps([[0.0, 0.0]]), torch.ones(1, 1, 1, 2, dtype=torch.bool), eps=1.0)
    expected = 10 * math.sqrt(math.log(1.5) ** 2 / 2 + 0.15 * math.log(6) ** 2 / 4)
    assert loss.item() == pytest.approx(expected, rel=1e-5)


def test_silog_takes_its_statistics_over_the_batch():
    # Each image alone has no variance; together g = (ln 2, ln 2, 0, 0) has: sum of squares 4 (ln 2 / 2)^2, over 3.
    prediction, target = maps([[2.0, 2.0]], [[1.0, 1.0]]), torch.ones(2, 1, 1, 2)
    mask = torch.ones(2, 1, 1, 2, dtype=torch.bool)
    expected = 10 * math.log(2) * math.sqrt(1 / 3 + 0.15 / 4)
    assert silog(prediction, target, mask).item() == pytest.approx(expected, rel=1e-5)


def test_silog_of_a_perfect_prediction_is_almost_nothing_and_can_be_differentiated():
    target = maps([[1.0, 2.0, 5.0]])
    prediction = target.clone().requires_grad_()
    loss = silog(prediction, target, torch.ones_like(target, dtype=torch.bool))
    loss.backward()
    assert loss.item() == pytest.approx(1e-3, abs=1e-4)  # 10 sqrt(1e-8)
    assert prediction.grad.isfinite().all()


def test_silog_is_computed_in_float32_under_autocast():
    prediction, target, mask = random_maps()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        loss = silog(prediction, target, mask)
    assert loss.dtype == torch.float32
    assert loss.item() == silog(prediction, target, mask).item()


# --- domains ----------------------------------------------------------------------------------------------------------


def test_domain_cross_entropy_by_hand():
    # -ln(e^2 / (e^2 + 1)) = ln(1 + e^-2); -ln(1 / 2) = ln 2; their mean.
    logits = torch.tensor([[2.0, 0.0], [5.0, 5.0]])
    loss = domain_cross_entropy(logits, torch.tensor([0, 1]))
    assert loss.item() == pytest.approx((math.log1p(math.exp(-2)) + math.log(2)) / 2, rel=1e-5)


# --- the parts of the relative loss -----------------------------------------------------------------------------------


def test_normalize_robust_by_hand():
    # median 3, deviations 2 1 0 1 4: mean 1.6
    x = torch.tensor([[[1.0, 2.0, 3.0, 4.0, 7.0]]])
    found = normalize_robust(x, torch.ones_like(x, dtype=torch.bool))
    assert found.flatten().tolist() == pytest.approx([-1.25, -0.625, 0, 0.625, 2.5])


def test_normalize_robust_takes_its_statistics_over_known_pixels_only():
    # Zeros for unknown pixels, counted in, would make the median 0.
    x = torch.tensor([[[0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 4.0, 9.0]]])
    found = normalize_robust(x, x > 0)
    assert found[x > 0].tolist() == pytest.approx([(2 - 4) / (7 / 3), 0, (9 - 4) / (7 / 3)])


def test_normalize_robust_of_a_constant_is_zero():
    x = torch.full((1, 2, 3), 5.0)
    assert torch.equal(normalize_robust(x, torch.ones_like(x, dtype=torch.bool)), torch.zeros(1, 2, 3))


def test_gradient_flows_through_median_and_scale():
    """The normalised map does not see a shift or a factor, so its gradient has no component along either."""
    x = torch.tensor([[[1.0, 2.5, 3.0, 4.0, 7.0]]], requires_grad=True)
    weight = torch.tensor([0.3, -1.0, 2.0, 0.7, 1.1])
    (normalize_robust(x, torch.ones(1, 1, 5, dtype=torch.bool)).flatten() * weight).sum().backward()
    assert x.grad.sum().item() == pytest.approx(0, abs=1e-5)
    assert (x.grad * x).sum().item() == pytest.approx(0, abs=1e-5)
    assert x.grad.abs().max() > 0.1


def test_trimmed_absolute_error_by_hand():
    # U = floor(0.8 * 5) = 4 smallest of 1 2 3 4 100, over 2 * 5
    residual = torch.tensor([-3.0, 100.0, 1.0, -4.0, 2.0])
    assert trimmed_absolute_error(residual, trim=0.2).item() == pytest.approx(10 / 10)
    assert trimmed_absolute_error(residual, trim=0.0).item() == pytest.approx(110 / 10)
    # U = floor(0.8 * 4) = 3
    assert trimmed_absolute_error(residual[[0, 1, 2, 4]], trim=0.2).item() == pytest.approx(6 / 8)


@pytest.mark.parametrize(("trim", "kept"), [(0.1, 9), (0.2, 8), (0.3, 7), (0.5, 5), (0.7, 3), (0.9, 1)])
def test_trim_keeps_exactly_the_share_that_is_left(trim: float, kept: int):
    assert trimmed_absolute_error(torch.ones(10), trim=trim).item() == pytest.approx(kept / 20)


def test_trimmed_residuals_get_no_gradient():
    residual = torch.tensor([1.0, 2.0, 3.0, 4.0, 100.0], requires_grad=True)
    trimmed_absolute_error(residual, trim=0.2).backward()
    assert residual.grad.tolist() == pytest.approx([0.1, 0.1, 0.1, 0.1, 0.0])


@pytest.mark.parametrize("trim", [-0.1, 1.0, 2.0])
def test_impossible_trim_is_an_error(trim: float):
    with pytest.raises(InputError, match="trim"):
        trimmed_absolute_error(torch.ones(4), trim=trim)


def test_gradient_error_by_hand():
    # Across: |2 - 1| + |3 - 5| = 3. Down: |5 - 1| + |3 - 2| = 5. Over 4 pixels: 2. At stride 2: one pixel alone.
    residual = torch.tensor([[1.0, 2.0], [5.0, 3.0]])
    mask = torch.ones(2, 2, dtype=torch.bool)
    assert gradient_error(residual, mask, n_scales=1).item() == pytest.approx(2.0)
    assert gradient_error(residual, mask, n_scales=4).item() == pytest.approx(2.0)
    # Without the last pixel: across 1, down 4, over 3 pixels.
    mask[1, 1] = False
    assert gradient_error(residual, mask, n_scales=1).item() == pytest.approx(5 / 3)


@pytest.mark.parametrize("n_scales", [1, 2, 4])
def test_gradient_error_against_a_loop(n_scales: int):
    prediction, _, mask = random_maps(size=(11, 14))
    residual, known = prediction[0, 0] - 0.5, mask[0, 0]
    total = 0.0
    for scale in range(n_scales):
        rows, columns = range(0, 11, 2**scale), range(0, 14, 2**scale)
        differences, count = 0.0, 0
        for y in rows:
            for x in columns:
                count += bool(known[y, x])
                for other_y, other_x in ((y, x + 2**scale), (y + 2**scale, x)):
                    if other_y in rows and other_x in columns and known[y, x] and known[other_y, other_x]:
                        differences += abs(residual[y, x].item() - residual[other_y, other_x].item())
        total += differences / count
    assert gradient_error(residual, known, n_scales=n_scales).item() == pytest.approx(total, rel=1e-5)


# --- the relative loss ------------------------------------------------------------------------------------------------


def reference_relative_loss(prediction: Tensor, target: Tensor, mask: Tensor) -> float:
    """Per image: both maps freed of scale and shift, the smallest 80 % of the residuals, no gradient term."""
    losses = []
    for image, truth, known in zip(prediction, target, mask, strict=True):
        normed = []
        for x in (image, truth):
            values = sorted(x[known].tolist())
            middle = values[(len(values) - 1) // 2]
            deviation = sum(abs(v - middle) for v in values) / len(values)
            normed.append([(v - middle) / deviation for v in x[known].tolist()])
        residuals = sorted(abs(p - t) for p, t in zip(*normed, strict=True))
        losses.append(sum(residuals[: math.floor(0.8 * len(residuals))]) / (2 * len(residuals)))
    return sum(losses) / len(losses)


def test_relative_loss_against_a_loop():
    prediction, target, mask = random_maps()
    expected = reference_relative_loss(prediction, target, mask)
    found = scale_and_shift_invariant(prediction, target, mask, gradient_weight=0.0)
    assert found.item() == pytest.approx(expected, rel=1e-4)


def test_relative_loss_adds_the_weighted_gradients_of_the_residual():
    prediction, target, mask = random_maps(batch=1)
    residual = normalize_robust(prediction[0], mask[0]) - normalize_robust(target[0], mask[0])
    gradients = gradient_error(residual[0], mask[0, 0], n_scales=4).item()
    without, half, double = (
        scale_and_shift_invariant(prediction, target, mask, gradient_weight=weight).item() for weight in (0.0, 0.5, 2.0)
    )
    assert half - without == pytest.approx(0.5 * gradients, rel=1e-4)
    assert double - without == pytest.approx(2 * gradients, rel=1e-4)
    assert scale_and_shift_invariant(prediction, target, mask).item() == half


@pytest.mark.parametrize(("scale", "shift"), [(7.0, 0.0), (1.0, 3.0), (0.05, -2.0)])
def test_relative_loss_does_not_see_scale_and_shift(scale: float, shift: float):
    prediction, target, mask = random_maps()
    loss = scale_and_shift_invariant(prediction, target, mask).item()
    assert loss > 0.1
    assert scale_and_shift_invariant(scale * prediction + shift, target, mask).item() == pytest.approx(loss, rel=1e-3)
    assert scale_and_shift_invariant(prediction, scale * target + shift, mask).item() == pytest.approx(loss, rel=1e-3)
    assert scale_and_shift_invariant(scale * target + shift, target, mask).item() == pytest.approx(0, abs=1e-4)


def test_relative_loss_is_the_mean_of_the_images_alone():
    """One image much harder than the other: trimming over the batch would cut into it alone."""
    prediction, target, mask = random_maps()
    prediction[0] = target[0] + 0.01 * prediction[0]
    alone = [scale_and_shift_invariant(prediction[i : i + 1], target[i : i + 1], mask[i : i + 1]) for i in range(2)]
    assert alone[0] < 0.2 * alone[1]
    together = scale_and_shift_invariant(prediction, target, mask)
    assert together.item() == pytest.approx((alone[0].item() + alone[1].item()) / 2, rel=1e-5)


def test_relative_loss_forgets_outliers_below_the_trim():
    """Nothing but a factor on the outliers, within the 20 %: they change no median, and no residual that is kept."""
    target = torch.linspace(0, 1, 200).view(1, 1, 10, 20)
    mask = torch.ones_like(target, dtype=torch.bool)
    residual = torch.zeros(200)
    residual[:40] = 5.0
    assert trimmed_absolute_error(residual, trim=0.2).item() == 0
    residual[:41] = 5.0
    assert trimmed_absolute_error(residual, trim=0.2).item() == pytest.approx(5 / 400)
    wrong = target.clone()
    wrong[..., 0, :15] += 0.2
    kept, all_of_it = (
        scale_and_shift_invariant(wrong, target, mask, trim=trim, gradient_weight=0.0).item() for trim in (0.2, 0.0)
    )
    assert kept < 0.6 * all_of_it


def test_image_with_few_known_pixels_is_left_out():
    prediction, target, mask = random_maps()
    mask[0] = False
    mask[0, 0, 0, :10] = True
    alone = scale_and_shift_invariant(prediction[1:], target[1:], mask[1:]).item()
    assert scale_and_shift_invariant(prediction, target, mask).item() == pytest.approx(alone, rel=1e-6)
    both = scale_and_shift_invariant(prediction, target, mask, min_pixels=10).item()
    assert both != pytest.approx(alone, rel=1e-3)


def test_image_counts_from_a_hundred_known_pixels_on():
    prediction, target, _ = random_maps()
    mask = torch.zeros_like(target, dtype=torch.bool)
    mask.flatten(1)[0, :100] = True
    mask.flatten(1)[1, :99] = True
    losses, counted = losses_of_images(prediction, target, mask)
    assert counted.tolist() == [True, False]
    assert losses[0] > 0
    assert losses[1] == 0


def test_relative_loss_has_four_scales():
    prediction, target, mask = random_maps(size=(20, 24))
    found, four, five = (
        losses_of_images(prediction, target, mask, **scales)[0].tolist()
        for scales in ({}, {"n_scales": 4}, {"n_scales": 5})
    )
    assert found == four
    assert found[0] < five[0]


def test_relative_loss_takes_a_gradient_weight_for_each_image():
    prediction, target, mask = random_maps()
    losses, counted = losses_of_images(prediction, target, mask, gradient_weight=torch.tensor([0.5, 0.0]))
    with_term, _ = losses_of_images(prediction, target, mask, gradient_weight=0.5)
    without, _ = losses_of_images(prediction, target, mask, gradient_weight=0.0)
    assert counted.tolist() == [True, True]
    assert losses.tolist() == [with_term[0], without[1]]
    assert with_term[1] > without[1]


# --- several processes ------------------------------------------------------------------------------------------------


def test_silog_of_two_processes_is_that_of_the_whole_batch():
    """The sums of the other process stand in for it: total adds them, in the order they are asked for."""
    prediction, target, mask = random_maps()
    whole = silog(prediction, target, mask)
    known = mask.flatten()
    g = (torch.log(prediction + 1e-7) - torch.log(target + 1e-7)).flatten()
    half = len(known) // 2
    rest = g[half:][known[half:]]
    others = [torch.tensor(float(len(rest))), rest.sum(), (rest - g[known].mean()).square().sum()]
    found = silog(prediction[:1], target[:1], mask[:1], total=lambda x: x + others.pop(0))
    assert found.item() == pytest.approx(whole.item(), rel=1e-5)
    assert not others


def test_mean_counted_divides_by_the_images_of_all_processes():
    losses, counted = torch.tensor([1.0, 5.0, 9.0]), torch.tensor([True, False, True])
    assert mean_counted(losses, counted).item() == 5
    others = [torch.tensor(20.0), torch.tensor(3.0)]
    assert mean_counted(losses, counted, total=lambda x: x + others.pop(0)).item() == 6
    assert mean_counted(losses, torch.zeros(3, dtype=torch.bool)).item() == 0


# --- promises of all of them ------------------------------------------------------------------------------------------

LOSSES = pytest.mark.parametrize("loss", [silog, scale_and_shift_invariant])


@LOSSES
@pytest.mark.parametrize("value", [0.0, -3.0, 1e6, math.nan, math.inf])
def test_unknown_pixels_do_not_matter(loss: Callable[..., Tensor], value: float):
    """Whatever the target is where it is unknown; neither the loss nor the gradient sees it."""
    prediction, target, mask = random_maps()
    results = []
    for truth in (target, target.masked_fill(~mask, value)):
        leaf = prediction.clone().requires_grad_()
        result = loss(leaf, truth, mask)
        result.backward()
        results.append((result.item(), leaf.grad))
    assert results[1][0] == results[0][0]
    assert torch.equal(results[1][1], results[0][1])
    assert not results[0][1][~mask].any()


@LOSSES
def test_prediction_where_the_target_is_unknown_does_not_matter(loss: Callable[..., Tensor]):
    prediction, target, mask = random_maps()
    changed = torch.where(mask, prediction, 50 * prediction)
    assert loss(changed, target, mask).item() == loss(prediction, target, mask).item()


@LOSSES
@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_nothing_known_is_no_loss_and_no_gradient(loss: Callable[..., Tensor], factor: float):
    prediction, target, mask = random_maps()
    prediction = (factor * prediction).requires_grad_()
    result = loss(prediction, target, torch.zeros_like(mask))
    result.backward()
    assert result.item() == 0
    assert torch.equal(prediction.grad, torch.zeros_like(prediction))


@LOSSES
def test_going_down_the_gradient_lowers_the_loss(loss: Callable[..., Tensor]):
    prediction, target, mask = random_maps()
    prediction.requires_grad_()
    before = loss(prediction, target, mask)
    before.backward()
    assert prediction.grad.isfinite().all()
    step = 1e-3 * prediction.grad / prediction.grad.norm()
    assert loss(prediction.detach() - step, target, mask) < before


@LOSSES
def test_collapsed_prediction_has_a_finite_loss_and_gradient(loss: Callable[..., Tensor]):
    _, target, mask = random_maps()
    prediction = torch.zeros_like(target, requires_grad=True)
    result = loss(prediction, target, mask)
    result.backward()
    assert result.isfinite()
    assert prediction.grad.isfinite().all()


# --- terms of metric depth that the paper does not have ---------------------------------------------------------------


def test_log_gradient_is_the_mean_of_the_images_that_have_known_pixels():
    prediction, target, mask = random_maps(batch=3)
    mask[1] = False
    ratio = torch.log(prediction / target)
    expected = [gradient_error(ratio[i, 0], mask[i, 0], n_scales=4).item() for i in (0, 2)]
    loss = log_gradient(prediction, target.masked_fill(~mask, 0), mask)
    assert loss.item() == pytest.approx(sum(expected) / 2, rel=1e-4)  # the target is 0 where it is unknown
    assert log_gradient(7 * prediction, target, mask).item() == pytest.approx(loss.item(), rel=1e-4)  # any one factor


def test_spread_by_hand_and_least_where_it_is_the_error():
    depth, target = maps([[2.0, 4.0]]), maps([[1.0, 0.0]])
    known = torch.tensor([[[[True, False]]]])
    loss = spread(depth, maps([[0.5, 9.0]]), target, known, floor=0)
    assert loss.item() == pytest.approx(math.log(0.25) + 1 / 0.5)
    around = [spread(depth, maps([[s, 9.0]]), target, known, floor=0).item() for s in (0.9, 1.0, 1.1)]
    assert around[1] < min(around[0], around[2])
    sure = spread(depth, torch.zeros_like(depth), target, known)
    assert sure.item() == pytest.approx(math.log(0.02) + 1 / 0.04)
    assert spread(depth, depth, target, known & False).item() == 0


def test_spread_counts_images_alike_however_many_of_their_pixels_are_known():
    depth, target = maps([[2.0, 4.0]], [[1.0, 3.0]], [[5.0, 5.0]]), maps([[1.0, 3.0]], [[2.0, 0.0]], [[0.0, 0.0]])
    std, known = torch.full_like(depth, 0.5), target > 0
    alone = [spread(depth[i : i + 1], std[i : i + 1], target[i : i + 1], known[i : i + 1]).item() for i in (0, 1)]
    assert spread(depth, std, target, known).item() == pytest.approx(sum(alone) / 2)


def test_spread_moves_the_standard_deviation_and_not_the_depth():
    depth, std = maps([[2.0, 4.0]]).requires_grad_(), maps([[0.5, 0.5]]).requires_grad_()
    spread(depth, std, maps([[1.0, 3.0]]), torch.ones(1, 1, 1, 2, dtype=torch.bool)).backward()
    assert depth.grad is None
    assert std.grad is not None
    assert (std.grad < 0).all()  # it is too sure: the deviation grows
