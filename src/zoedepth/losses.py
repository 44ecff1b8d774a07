"""Losses: functions of tensors, computed in float32 whatever the autocast.

Predictions and targets are (batch, 1, height, width); masks are boolean and of the same shape, True where the target is
known. Every loss is 0 (with a gradient of 0) where nothing is known.
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
    """The sum over all processes where there is one: the tensor itself."""
    return x


def silog(
    prediction: Map, target: Map, mask: Mask, *, beta: float = 0.15, eps: float = 1e-7, total: Total = alone
) -> Float[Tensor, ""]:
    """Scale-invariant log loss: 10 sqrt(var(g) + beta mean(g)^2), g = ln(prediction) - ln(target), both in metres.

    The statistics are those of all known pixels of the batch together; the variance is the unbiased one. (Released
    ``trainers/loss.py::SILogLoss``; beta = 0.15 is lambda = 0.85 of Eigen et al.)

    Args:
        prediction, target: metres.
        mask: True where the target is known.
        beta: weight of the squared mean.
        eps: added before the logarithms.
        total: sums a tensor over all processes, so that the batch is that of all of them.
    """
    known = mask.flatten()
    n = total(known.sum().float())
    if n < 2:
        return 0 * prediction.float().sum()
    g = torch.log(prediction.float().flatten()[known] + eps) - torch.log(target.float().flatten()[known] + eps)
    mean = total(g.sum()) / n
    # The variance has no slope in the mean; detached, this process' share of that slope is 0 as well.
    variance = total((g - mean.detach()).square().sum()) / (n - 1)
    # 1e-8: the square root has an infinite slope at 0.
    return 10 * torch.sqrt(variance + beta * mean**2 + 1e-8)


def domain_cross_entropy(logits: Float[Tensor, "batch domains"], domain: Int[Tensor, " batch"]) -> Float[Tensor, ""]:
    """Cross-entropy of the router's scores against the domain labels (paper section 3.3, R.2)."""
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
    """The MiDaS loss of stage 1, on disparity: trimmed absolute error plus multi-scale gradients, of each image.

    Both maps of an image are first freed of scale and shift by :func:`normalize_robust`. (Ranftl et al. 2020.)

    Args:
        prediction: relative depth (inverse depth up to scale and shift).
        target: disparity, in any affine unit.
        mask: True where the target is known.
        trim: share of the largest residuals of each image that is ignored.
        gradient_weight: weight of the gradient term (alpha in MiDaS), one for all or one an image.
        n_scales: number of scales of the gradient term.
        min_pixels: images with fewer known pixels are left out.

    Returns:
        The loss of each image, 0 for those left out; and which are not.
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
    """Mean of the losses of the images that count, of all processes."""
    return total((losses * counted).sum()) / total(counted.sum().float()).clamp(min=1)


def normalize_robust(
    x: Float[Tensor, "1 height width"], mask: Bool[Tensor, "1 height width"]
) -> Float[Tensor, "1 height width"]:
    """(x - t) / s with t the median of the known pixels and s their mean absolute deviation from it."""
    known = x[mask]
    shift = known.median()
    scale = (known - shift).abs().mean().clamp(min=1e-6)
    return (x - shift) / scale


def trimmed_absolute_error(residual: Float[Tensor, " pixels"], *, trim: float) -> Float[Tensor, ""]:
    """Sum of the smallest (1 - trim) of the absolute residuals, over twice the number of all of them."""
    if not 0 <= trim < 1:
        raise InputError(f"trim must be in [0, 1); it is {trim}")
    n_kept = residual.numel() - math.ceil(trim * residual.numel() - 1e-9)  # 1e-9: 0.9 * 10 is 9, not 9.0000001
    kept = residual.abs().topk(n_kept, largest=False, sorted=False).values
    return kept.sum() / (2 * residual.numel())


def gradient_error(
    residual: Float[Tensor, "height width"], mask: Bool[Tensor, "height width"], *, n_scales: int
) -> Float[Tensor, ""]:
    """Mean absolute differences of the residual between neighbours, summed over scales of stride 1, 2, 4, ...

    A difference counts where both neighbours are known; each scale is divided by its number of known pixels.
    """
    residual = residual.masked_fill(~mask, 0)  # what is unknown may be anything, NaN too
    total = torch.zeros((), dtype=residual.dtype, device=residual.device)
    for scale in range(n_scales):
        r, m = residual[:: 2**scale, :: 2**scale], mask[:: 2**scale, :: 2**scale]
        across = ((r[:, 1:] - r[:, :-1]).abs() * (m[:, 1:] & m[:, :-1])).sum()
        down = ((r[1:] - r[:-1]).abs() * (m[1:] & m[:-1])).sum()
        total = total + (across + down) / m.sum().clamp(min=1)
    return total
