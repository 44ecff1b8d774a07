"""From a distribution over bins to depth: expected depth (Eq. 1), log-binomial (Eq. 4), softmax (ablation)."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

_EPS = 1e-7
"""Keeps Stirling's logarithms finite at k = 0 and k = n (released ``dist_layers.py``)."""
_PAIR_EPS = 1e-4
"""Keeps q and t inside their open intervals (released ``dist_layers.py``)."""


def expected_depth(
    probability: Float[Tensor, "batch bins height width"], bin_centers: Float[Tensor, "batch bins height width"]
) -> Float[Tensor, "batch 1 height width"]:
    """Eq. 1: d = sum_k p_k c_k, in the unit of the centers."""
    return (probability * bin_centers).sum(dim=1, keepdim=True)


def log_binomial_coefficients(n_bins: int) -> Float[Tensor, " bins"]:
    """ln C(n, k) for k = 0..n, n = n_bins - 1, by the leading terms of Stirling's approximation, as released.

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
    """Eq. 4 and the softmax after it: p_k = softmax_k(ln[C(n, k) q^k (1 - q)^(n - k)] / t).

    Args:
        q: place of the mode, 0 (first bin) to 1 (last bin).
        t: temperature, > 0; small is sharp.
        coefficients: ln C(n, k) of :func:`log_binomial_coefficients`.

    Returns:
        Probabilities in float32, summing to 1 over the bins, unimodal up to Stirling's error.
    """
    # ln(q^k (1 - q)^(n - k)) = k (ln q - ln(1 - q)) + n ln(1 - q), and the softmax does not see the last term. So the
    # logits are a product of two columns over the bins and two maps: one pass over memory in place of five.
    q, t = q.float(), t.float()
    odds = q.clamp(1e-4, 1).log() - (1 - q).clamp(1e-4, 1).log()
    maps = torch.cat([1 / t, odds / t], dim=1)
    k = torch.arange(len(coefficients), device=q.device, dtype=torch.float32)
    columns = torch.stack([coefficients, k], dim=1)
    with torch.autocast(q.device.type, enabled=False):  # the logits reach 63 ln(1e-4) / 0.02
        return F.conv2d(maps, columns[:, :, None, None]).softmax(dim=1)


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
        self.register_buffer("coefficients", torch.empty(n_bins), persistent=False)
        self.init_non_persistent_buffers()

    def init_non_persistent_buffers(self) -> None:
        """Fill what no checkpoint holds, after the module was built without memory (timm's name for it)."""
        self.coefficients.copy_(log_binomial_coefficients(len(self.coefficients)))

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch bins height width"]:
        """Probabilities over the bins, float32."""
        pairs = self.mlp(x).float() + _PAIR_EPS
        q0, q1, t0, t1 = pairs.split(1, dim=1)
        q = q0 / (q0 + q1)
        t = self.min_temperature + (self.max_temperature - self.min_temperature) * t0 / (t0 + t1)
        return log_binomial(q, t, self.coefficients)


class Softmax(nn.Module):
    """Free probabilities from the same input, for the paper's ablation (its Table 5)."""

    def __init__(self, channels: int, n_bins: int, *, bottleneck_factor: int) -> None:
        super().__init__()
        hidden = channels // bottleneck_factor
        self.mlp = nn.Sequential(nn.Conv2d(channels, hidden, 1), nn.GELU(), nn.Conv2d(hidden, n_bins, 1))

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch bins height width"]:
        """Probabilities over the bins, float32."""
        return F.softmax(self.mlp(x).float(), dim=1)
