"""From a distribution over bins to depth: expected depth (Eq. 1), log-binomial (Eq. 4), softmax (ablation)."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.model.upsample import upsample, upsample_rows

_EPS = 1e-7
"""Keeps Stirling's logarithms finite at k = 0 and k = n (released ``dist_layers.py``)."""
_PAIR_EPS = 1e-4
"""Keeps q and t inside their open intervals (released ``dist_layers.py``)."""


def expected_depth(
    probability: Float[Tensor, "*pixels bins"], bin_centers: Float[Tensor, "*pixels bins"]
) -> Float[Tensor, "*pixels"]:
    """Compute Eq. 1: d = sum_k p_k c_k, in the unit of the centers."""
    return (probability * bin_centers).sum(dim=-1)


def log_binomial_coefficients(n_bins: int) -> Float[Tensor, " bins"]:
    """Compute ln C(n, k) for k = 0..n, n = n_bins - 1, by the leading terms of Stirling's approximation, as released.

    The paper writes N = n_bins and k = 1..N; the released code uses n = N - 1 and k = 0..N - 1, which has N values.
    """
    k = torch.arange(n_bins, dtype=torch.float64) + _EPS
    n = n_bins - 1 + _EPS
    coefficients = n * torch.log(torch.tensor(n, dtype=torch.float64)) - k * k.log() - (n - k) * (n - k + _EPS).log()
    return coefficients.float()


def log_binomial(
    q: Float[Tensor, "batch 1 height width"],
    t: Float[Tensor, "batch 1 height width"],
    coefficients: Float[Tensor, " bins"],
) -> Float[Tensor, "batch bins height width"]:
    """Compute Eq. 4 and the softmax after it: p_k = softmax_k(ln[C(n, k) q^k (1 - q)^(n - k)] / t).

    Args:
        q: place of the mode, 0 (first bin) to 1 (last bin).
        t: temperature, > 0; small is sharp.
        coefficients: ln C(n, k), from ``log_binomial_coefficients``.

    Returns:
        Probabilities in float32, summing to 1 over the bins, unimodal up to Stirling's error.
    """
    maps, weight = log_binomial_terms(q, t, coefficients)
    return BinDistribution(maps, weight, None, centers=q).probability


def log_binomial_terms(
    q: Float[Tensor, "batch 1 height width"],
    t: Float[Tensor, "batch 1 height width"],
    coefficients: Float[Tensor, " bins"],
) -> tuple[Float[Tensor, "batch 2 height width"], Float[Tensor, "1 bins 2"]]:
    """Factor the logits of ``log_binomial``: into two maps, and two columns over the bins that all images share.

    ln(q^k (1 - q)^(n - k)) = k (ln q - ln(1 - q)) + n ln(1 - q), and the softmax does not see the last term.
    """
    q, t = q.float(), t.float()
    odds = q.clamp(1e-4, 1).log() - (1 - q).clamp(1e-4, 1).log()
    k = torch.arange(len(coefficients), device=q.device, dtype=torch.float32)
    return torch.cat([1 / t, odds / t], dim=1), torch.stack([coefficients, k], dim=1)[None]


def convolved(conv: nn.Conv2d, maps: Sequence[Tensor]) -> Float[Tensor, "batch output_channels height width"]:
    """Apply a 1x1 convolution to maps that are upsampled to the size of the first one and stacked.

    Convolution and interpolation commute: each map is convolved at its own size, and no stack is made.
    """
    size = maps[0].shape[-2:]
    weights = conv.weight.split([x.shape[1] for x in maps], dim=1)
    first, *others = (F.conv2d(x, weight) for x, weight in zip(maps, weights, strict=True))
    out = first if conv.bias is None else first + conv.bias[:, None, None]
    for x in others:
        out = out + upsample(x, size)
    return out


class BinDistribution(NamedTuple):
    """A distribution over bins at every pixel, kept as the small maps that it is computed from.

    Probabilities and centers have a channel for each bin. At the size of the photo that is far more memory than all
    other maps take, so the mean is computed in bands of rows, each small enough for the processor's cache.
    """

    maps: Float[Tensor, "batch terms height width"]
    weight: Float[Tensor, "_ bins terms"] | None
    """The logits are weight @ maps + bias, in float32; without a weight they are the maps. The first axis is 1, for a
    weight that all images share, or the batch."""
    bias: Float[Tensor, "_ bins"] | None
    centers: Float[Tensor, "batch bins _ _"]
    """Metres, at the size of the maps or any other, from which they are upsampled."""

    @property
    def probability(self) -> Float[Tensor, "batch bins height width"]:
        """Probabilities, which sum to 1 over the bins."""
        return self._probability(slice(None)).permute(0, 3, 1, 2)

    @property
    def bin_centers(self) -> Float[Tensor, "batch bins height width"]:
        """Bin centers, metres."""
        return self._centers(slice(None)).permute(0, 3, 1, 2).expand(-1, -1, *self.maps.shape[-2:])

    def mean(self) -> Float[Tensor, "batch 1 height width"]:
        """Compute the expected depth, metres (Eq. 1)."""
        bands = [expected_depth(self._probability(rows), self._centers(rows)) for rows in self._bands()]
        return torch.cat(bands, dim=1)[:, None]

    def mean_and_std(self) -> tuple[Float[Tensor, "batch 1 height width"], Float[Tensor, "batch 1 height width"]]:
        """Compute the expected depth and the standard deviation around it, metres: at least a micrometre.

        The root of 0 has no gradient.
        """
        means, variances = [], []
        for rows in self._bands():
            probability, centers = self._probability(rows), self._centers(rows)
            mean = expected_depth(probability, centers)
            means.append(mean)
            variances.append(expected_depth(probability, (centers - mean[..., None]).square()))
        return torch.cat(means, dim=1)[:, None], torch.cat(variances, dim=1)[:, None].clamp(min=1e-12).sqrt()

    def mixed(self, weight: Float[Tensor, " batch"]) -> "BinDistribution":
        """Make this one part of a mixture: after joining it with the others, its probabilities sum to the weight."""
        logits = self._logits(slice(None)).log_softmax(dim=3) + weight.log()[:, None, None, None]
        return BinDistribution(logits.permute(0, 3, 1, 2), None, None, self.bin_centers)

    def _bands(self) -> list[slice]:
        batch, _, height, width = self.maps.shape
        if self.maps.device.type != "cpu" or torch.is_grad_enabled() or torch.compiler.is_compiling():
            # Bands gain nothing: a GPU would start a kernel for each, gradients keep everything, compilers fuse anyway.
            return [slice(None)]
        rows = max(1, _BAND // (batch * width * self.centers.shape[1]))
        return [slice(start, min(start + rows, height)) for start in range(0, height, rows)]

    # Below, each pixel's bins lie side by side in memory: a softmax is fast in this order only.

    def _probability(self, rows: slice) -> Float[Tensor, "batch rows width bins"]:
        return self._logits(rows).softmax(dim=3)

    def _logits(self, rows: slice) -> Float[Tensor, "batch rows width bins"]:
        maps = self.maps[:, :, rows].permute(0, 2, 3, 1)
        if self.weight is None:
            return maps
        with torch.autocast(maps.device.type, enabled=False):  # logits of the log-binomial reach 63 ln(1e-4) / 0.02
            if self.weight.shape[0] == 1:
                return F.linear(maps, self.weight[0], None if self.bias is None else self.bias[0])
            logits = maps @ self.weight.transpose(1, 2)[:, None]
            return logits if self.bias is None else logits + self.bias[:, None, None]

    def _centers(self, rows: slice) -> Float[Tensor, "batch _ _ bins"]:
        one = self.centers.shape[-2:] == (1, 1)  # every pixel has the same centers
        centers = self.centers if one else upsample_rows(self.centers, self.maps.shape[-2:], rows)
        return centers.permute(0, 2, 3, 1)


_BAND = 2**19
"""Probabilities in a band: 2 MB in float32."""


class LogBinomial(nn.Module):
    """Predicts q and t of the log-binomial from decoder features and bin embedding (``ConditionalLogBinomial``)."""

    def __init__(
        self, channels: int, n_bins: int, *, bottleneck_factor: int, min_temperature: float, max_temperature: float
    ) -> None:
        super().__init__()
        hidden = channels // bottleneck_factor
        self.mlp = nn.Sequential(nn.Conv2d(channels, hidden, 1), nn.GELU(), nn.Conv2d(hidden, 4, 1), nn.Softplus())
        self.min_temperature = min_temperature
        self.max_temperature = max_temperature
        self.coefficients: Tensor
        self.register_buffer("coefficients", torch.empty(n_bins, dtype=torch.float32), persistent=False)
        self.init_non_persistent_buffers()

    def init_non_persistent_buffers(self) -> None:
        """Fill the buffers that no checkpoint holds, after the module was built without memory (timm's name for it)."""
        self.coefficients.copy_(log_binomial_coefficients(len(self.coefficients)))

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> nn.Module:
        """Keep the coefficients in float32, whatever ``model.half()`` and the like make of the weights.

        They reach 40 and are exponents: bfloat16 would round them by an eighth.
        """
        super()._apply(fn, recurse)
        self.coefficients = log_binomial_coefficients(len(self.coefficients)).to(self.coefficients.device)
        return self

    def forward(self, maps: Sequence[Tensor], centers: Float[Tensor, "batch bins _ _"]) -> BinDistribution:
        """Predict the distribution over bins at these centers.

        Args:
            maps: the input, as maps whose channels add up to ``channels``; see ``convolved``.
            centers: bin centers, metres.
        """
        hidden: Any = self.mlp[0]
        pairs = self.mlp[1:](convolved(hidden, maps)).float() + _PAIR_EPS
        q0, q1, t0, t1 = pairs.split(1, dim=1)
        q = q0 / (q0 + q1)
        t = self.min_temperature + (self.max_temperature - self.min_temperature) * t0 / (t0 + t1)
        terms, weight = log_binomial_terms(q, t, self.coefficients)
        return BinDistribution(terms, weight, None, centers)


class Softmax(nn.Module):
    """Predicts free probabilities from the same input, for the paper's ablation (its Table 5)."""

    def __init__(self, channels: int, n_bins: int, *, bottleneck_factor: int) -> None:
        super().__init__()
        hidden = channels // bottleneck_factor
        self.mlp = nn.Sequential(nn.Conv2d(channels, hidden, 1), nn.GELU(), nn.Conv2d(hidden, n_bins, 1))

    def forward(self, maps: Sequence[Tensor], centers: Float[Tensor, "batch bins _ _"]) -> BinDistribution:
        """Predict the distribution over bins at these centers.

        Args:
            maps: the input, as maps whose channels add up to ``channels``; see ``convolved``.
            centers: bin centers, metres.
        """
        hidden: Any = self.mlp[0]
        last: Any = self.mlp[2]
        terms = self.mlp[1:2](convolved(hidden, maps)).float()
        return BinDistribution(terms, last.weight.flatten(1).float()[None], last.bias.float()[None], centers)


def build_probability(
    kind: str,
    channels: int,
    n_bins: int,
    *,
    bottleneck_factor: int,
    min_temperature: float,
    max_temperature: float,
) -> LogBinomial | Softmax:
    """Build the predictor of a head's probabilities.

    Args:
        kind: "log-binomial" or "softmax".
        channels: channels of the input.
        n_bins: number of bins.
        bottleneck_factor: the hidden width is the number of channels divided by this.
        min_temperature, max_temperature: bounds of the log-binomial's temperature.
    """
    if kind == "softmax":
        return Softmax(channels, n_bins, bottleneck_factor=bottleneck_factor)
    return LogBinomial(
        channels,
        n_bins,
        bottleneck_factor=bottleneck_factor,
        min_temperature=min_temperature,
        max_temperature=max_temperature,
    )
