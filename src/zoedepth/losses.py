"""Losses: functions of tensors, computed in float32 whatever the autocast.

Predictions and targets are (batch, 1, height, width). Masks are boolean, have the same shape, and are True where the
target is known. If nothing is known, every loss is 0, and so is its gradient.
"""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from zoedepth.errors import InputError

Map = Float[Tensor, "batch 1 height width"]
Mask = Bool[Tensor, "batch 1 height width"]
Total = Callable[[Tensor], Tensor]


def alone(x: Tensor) -> Tensor:
    """Sum over all processes where there is only one: return the tensor itself."""
    return x


def silog(
    prediction: Map, target: Map, mask: Mask, *, beta: float = 0.15, eps: float = 1e-7, total: Total = alone
) -> Float[Tensor, ""]:
    """Compute the scale-invariant log loss: 10 sqrt(var(g) + beta mean(g)^2), g = ln(prediction) - ln(target).

    The statistics are taken over all known pixels of the batch together; the variance is unbiased. (Released
    ``trainers/loss.py::SILogLoss``; beta = 0.15 is lambda = 0.85 of Eigen et al.)

    Args:
        prediction: metres.
        target: metres.
        mask: True where the target is known.
        beta: weight of the squared mean.
        eps: added before the logarithms.
        total: sums a tensor over all processes, so that all their images are one batch.
    """
    known = mask.flatten()
    n = total(known.sum().float())
    if n < 2:
        return 0 * prediction.float().sum()
    g = torch.log(prediction.float().flatten()[known] + eps) - torch.log(target.float().flatten()[known] + eps)
    mean = total(g.sum()) / n
    # The variance has no slope in the mean. Without detach, this process would see its own share of that slope.
    variance = total((g - mean.detach()).square().sum()) / (n - 1)
    # 1e-8: the square root has an infinite slope at 0.
    return 10 * torch.sqrt(variance + beta * mean**2 + 1e-8)


def ordinal(
    logits: Float[Tensor, "batch intervals rows columns"],
    edges: Float[Tensor, "batch edges"],
    target: Map,
    mask: Mask,
    *,
    total: Total = alone,
) -> Float[Tensor, ""]:
    """Compute DORN's loss: binary cross-entropies summed over the intervals, their mean over all known pixels.

    Logit k says that the depth lies beyond interval k. (Fu et al. 2018, Eqs. 3 and 4, with one logit for each interval
    in place of a softmax over two, which is the same.)

    Args:
        logits: logits of the probabilities, at any resolution; the target is read at the pixels nearest to theirs.
        edges: where the intervals of each image begin and end, metres.
        target: metres.
        mask: True where the target is known.
        total: see ``silog``.
    """
    size = logits.shape[-2:]
    depth, known = (
        F.interpolate(target.float(), size, mode="nearest"),
        F.interpolate(mask.float(), size, mode="nearest"),
    )
    beyond = (depth >= edges[:, 1:, None, None]).float()
    entropies = F.binary_cross_entropy_with_logits(logits.float(), beyond, reduction="none").sum(dim=1, keepdim=True)
    return total((entropies * known).sum()) / total(known.sum()).clamp(min=1)


def bins_chamfer(
    centers: Float[Tensor, "batch bins"], target: Map, mask: Mask, *, max_points: int = 2**14, total: Total = alone
) -> Float[Tensor, ""]:
    """Compute AdaBins' loss of bin centers: their ``chamfer`` distance to the true depths of the image.

    It is the mean over the images, of all processes, that have a known depth. (Bhat et al. 2021, Eq. 5; AdaBins
    ``loss.py::BinsChamferLoss``.)

    Args:
        centers: bin centers of the whole image, metres, in any order.
        target: metres.
        mask: True where the target is known.
        max_points: an image with more known pixels is represented by this number of them, evenly spread.
        total: see ``silog``.
    """
    losses = []
    counted = mask.flatten(1).any(dim=1)
    for bins, truth, known, counts in zip(centers.float(), target.float(), mask, counted.tolist(), strict=True):
        if not counts:
            losses.append(0 * bins.sum())
            continue
        points = truth[known]
        if len(points) > max_points:
            places = torch.arange(max_points, device=points.device) * len(points) // max_points
            points = points[places]
        losses.append(chamfer(bins[None], points[None], torch.ones_like(points[None], dtype=torch.bool))[0])
    return mean_counted(torch.stack(losses), counted, total=total)


def window_bins_chamfer(
    boxes: Float[Tensor, "batch windows 4"],
    centers: tuple[Float[Tensor, "batch windows _"], ...],
    target: Map,
    mask: Mask,
    *,
    n_sizes: int = 5,
    gamma: float = 0.3,
    total: Total = alone,
) -> Float[Tensor, ""]:
    """Compute LocalBins' loss of local histograms: the ``chamfer`` distance of windows' bins to the depths inside.

    A window counts if more than half of its pixels are known. The loss is the mean over the windows of one size; then
    the mean over the sizes that have such windows, with weights 1 for the smallest, gamma for the next, gamma ** 2 and
    so on; then the sum over the levels, with weights 1 for the finest, gamma for the one before and so on. (Bhat et al.
    2022; LocalBins ``loss.py::MultiScaleBinsLossV5``.)

    Args:
        boxes: left, top, right, bottom, as fractions of the image; smallest windows first, as many of each size.
        centers: bin centers of each window, metres, from the coarsest level to the finest.
        target: metres.
        mask: True where the target is known.
        n_sizes: number of sizes of windows.
        gamma: factor between the weights of one size, or level, and the next.
        total: see ``silog``.
    """
    sums, counts = [], []
    for windows, *bins in zip(*(x.chunk(n_sizes, dim=1) for x in (boxes, *centers)), strict=True):
        depth, known = (x.flatten(0, 1) for x in _inside(windows, target.float(), mask))
        counted = known.float().mean(dim=1) > 0.5
        sums.append(torch.stack([(chamfer(x.flatten(0, 1), depth, known) * counted).sum() for x in bins]))
        counts.append(counted.sum().float())
    n = total(torch.stack(counts))
    means = total(torch.stack(sums)) / n.clamp(min=1)[:, None]
    weights = gamma ** torch.arange(n_sizes, device=n.device) * (n > 0)
    levels = (weights[:, None] * means).sum(dim=0) / weights.sum().clamp(min=gamma**n_sizes)
    return (gamma ** torch.arange(len(centers) - 1, -1, -1, device=n.device) * levels).sum()


def chamfer(
    centers: Float[Tensor, "rows bins"], points: Float[Tensor, "rows points"], known: Bool[Tensor, "rows points"]
) -> Float[Tensor, " rows"]:
    """Add the mean squared distances of the centers to their nearest point, and of the points to their nearest center.

    Centers and points lie on a line and can be sorted, so that n log n steps do what takes n ** 2 in space.

    Args:
        centers: centers of each row; the loss has a gradient in them.
        points: points of each row.
        known: True where there is a point. The loss of a row without points is finite, but means nothing.
    """
    with torch.autocast(centers.device.type, enabled=False):
        centers = centers.float().sort(dim=1).values
        n = known.sum(dim=1)
        # Unknown points become copies of the largest one: no distance to the nearest point changes.
        points = torch.where(known, points.float(), -torch.inf)
        largest = torch.where(n > 0, points.amax(dim=1), 0)[:, None]
        points = torch.where(known, points, largest).sort(dim=1).values
        there = torch.arange(points.shape[1], device=points.device) < n[:, None]
        to_points = (centers - _nearest(points, centers)).square().mean(dim=1)
        to_centers = ((points - _nearest(centers, points)).square() * there).sum(dim=1) / n.clamp(min=1)
        return to_points + to_centers


def _nearest(
    values: Float[Tensor, "rows values"], queries: Float[Tensor, "rows queries"]
) -> Float[Tensor, "rows queries"]:
    """Return, for each query, the nearest of the sorted values in its row."""
    after = torch.searchsorted(values.detach(), queries.detach()).clamp(max=values.shape[1] - 1)
    above, below = values.gather(1, after), values.gather(1, (after - 1).clamp(min=0))
    return torch.where((queries - below).abs() <= (above - queries).abs(), below, above)


def _inside(
    boxes: Float[Tensor, "batch windows 4"], target: Map, mask: Mask
) -> tuple[Float[Tensor, "batch windows points"], Bool[Tensor, "batch windows points"]]:
    """Return the depths at the pixels inside boxes of one size, and True where they are known."""
    height, width = target.shape[-2:]
    left, top, right, bottom = boxes.unbind(dim=2)
    sides = torch.stack([(bottom - top)[0, 0] * height, (right - left)[0, 0] * width]).tolist()
    n_rows, n_columns = (max(round(side), 1) for side in sides)

    def pixels(start: Tensor, end: Tensor, n: int, side: int) -> Tensor:
        middles = (torch.arange(n, device=boxes.device) + 0.5) / n
        place = start[..., None] + (end - start)[..., None] * middles
        return (place * side).long().clamp(0, side - 1)

    index = pixels(top, bottom, n_rows, height)[..., :, None] * width
    index = (index + pixels(left, right, n_columns, width)[..., None, :]).flatten(1)
    depth, known = (x.flatten(1).gather(1, index).unflatten(1, (boxes.shape[1], -1)) for x in (target, mask))
    return depth, known


def log_gradient(
    prediction: Map, target: Map, mask: Mask, *, n_scales: int = 4, eps: float = 1e-7, total: Total = alone
) -> Float[Tensor, ""]:
    """Compute the error of the depth's edges: ``gradient_error`` of ln(prediction) - ln(target), the mean over images.

    Images without known pixels do not count. (Not in the paper: MiDaS' gradient term, for depth in metres.)
    """
    residual = torch.log(prediction.float() + eps) - torch.log(target.float().clamp(min=0) + eps)
    images = torch.stack([gradient_error(r[0], m[0], n_scales=n_scales) for r, m in zip(residual, mask, strict=True)])
    return mean_counted(images, mask.flatten(1).any(dim=1), total=total)


def spread(
    depth: Map, std: Map, target: Map, mask: Mask, *, floor: float = 0.02, total: Total = alone
) -> Float[Tensor, ""]:
    """Compute how badly the standard deviation tells the error: ln(s / d) + |d - target| / s, the mean over images.

    It is least where s is the error to be expected of such pixels. The depth d is taken as it is: no gradient makes it
    worse to be surer of it. Images without known pixels do not count. (Not in the paper: the negative log-likelihood of
    Laplace's distribution.)

    Args:
        depth: d, metres, > 0.
        std: metres; s is the root of its square and that of the floor.
        target: metres; anything where it is unknown.
        mask: True where it is known.
        floor: share of d that s has at least, so that a pixel of which the model is far too sure does not outweigh all
            others.
        total: sums a tensor over all processes.
    """
    depth, mask = depth.detach().float(), mask.bool()
    s = torch.hypot(std.float(), floor * depth)
    error = torch.where(mask, (depth - target.float()).abs(), 0.0)
    pixels = torch.where(mask, torch.log(s / depth) + error / s, 0.0)
    n_known = mask.flatten(1).sum(dim=1)
    return mean_counted(pixels.flatten(1).sum(dim=1) / n_known.clamp(min=1), n_known > 0, total=total)


def domain_cross_entropy(logits: Float[Tensor, "batch domains"], domain: Int[Tensor, " batch"]) -> Float[Tensor, ""]:
    """Compute the cross-entropy of the router's scores against the domain labels (paper section 3.3, R.2)."""
    return F.cross_entropy(logits.float(), domain)


def scale_and_shift_invariant(
    prediction: Map,
    target: Map,
    mask: Mask,
    *,
    trim: float = 0.2,
    gradient_weight: float | Float[Tensor, " batch"] = 0.5,
    n_scales: int = 4,
    min_pixels: int = 100,
) -> tuple[Float[Tensor, " batch"], Bool[Tensor, " batch"]]:
    """Compute the MiDaS loss of stage 1 for each image, on disparity: trimmed absolute error and multi-scale gradients.

    ``normalize_robust`` first frees both maps of an image of scale and shift. (Ranftl et al. 2020.)

    Args:
        prediction: relative depth (inverse depth up to scale and shift).
        target: disparity, in any affine unit.
        mask: True where the target is known.
        trim: share of the residuals of each image that is ignored, the largest ones.
        gradient_weight: weight of the gradient term (alpha in MiDaS), one for all images or one for each.
        n_scales: number of scales of the gradient term.
        min_pixels: images with fewer known pixels are left out.

    Returns:
        The loss of each image, 0 for those left out; and True for the images that count.
    """
    weights = torch.as_tensor(gradient_weight, device=prediction.device).expand(len(prediction)).tolist()
    counted = mask.flatten(1).sum(1) >= min_pixels
    losses = []
    for image, truth, known, counts, weight in zip(
        prediction.float(), target.float(), mask, counted.tolist(), weights, strict=True
    ):
        if not counts:
            losses.append(0 * image.sum())
            continue
        residual = normalize_robust(image, known) - normalize_robust(truth, known)
        loss = trimmed_absolute_error(residual[known], trim=trim)
        if weight > 0:
            loss = loss + weight * gradient_error(residual[0], known[0], n_scales=n_scales)
        losses.append(loss)
    return torch.stack(losses), counted


def mean_counted(
    losses: Float[Tensor, " batch"], counted: Bool[Tensor, " batch"], *, total: Total = alone
) -> Float[Tensor, ""]:
    """Average the losses of the images that count, over all processes."""
    return total((losses * counted).sum()) / total(counted.sum().float()).clamp(min=1)


def normalize_robust(
    x: Float[Tensor, "1 height width"], mask: Bool[Tensor, "1 height width"]
) -> Float[Tensor, "1 height width"]:
    """Compute (x - t) / s, with t the median of the known pixels and s their mean absolute deviation from it."""
    known = x[mask]
    shift = known.median()
    scale = (known - shift).abs().mean().clamp(min=1e-6)
    return (x - shift) / scale


def trimmed_absolute_error(residual: Float[Tensor, " pixels"], *, trim: float) -> Float[Tensor, ""]:
    """Sum the smallest (1 - trim) of the absolute residuals, and divide by twice the number of all of them."""
    if not 0 <= trim < 1:
        raise InputError(f"trim is {trim}. It must be at least 0 and less than 1.")
    n_kept = residual.numel() - math.ceil(trim * residual.numel() - 1e-9)  # 1e-9: 0.9 * 10 is 9, not 9.0000001
    kept = residual.abs().topk(n_kept, largest=False, sorted=False).values
    return kept.sum() / (2 * residual.numel())


def gradient_error(
    residual: Float[Tensor, "height width"], mask: Bool[Tensor, "height width"], *, n_scales: int
) -> Float[Tensor, ""]:
    """Average the absolute differences of the residual between neighbours, and add up strides 1, 2, 4 and so on.

    A difference counts where both neighbours are known; each scale is divided by its number of known pixels.
    """
    residual = residual.masked_fill(~mask, 0)  # unknown pixels may hold anything, even NaN
    total = torch.zeros((), dtype=residual.dtype, device=residual.device)
    for scale in range(n_scales):
        r, m = residual[:: 2**scale, :: 2**scale], mask[:: 2**scale, :: 2**scale]
        across = ((r[:, 1:] - r[:, :-1]).abs() * (m[:, 1:] & m[:, :-1])).sum()
        down = ((r[1:] - r[:-1]).abs() * (m[1:] & m[:-1])).sum()
        total = total + (across + down) / m.sum().clamp(min=1)
    return total
