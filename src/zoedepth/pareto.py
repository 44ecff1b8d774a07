"""Many tasks, one network: the weights under which a step makes none of them worse (MGDA).

Let g_l be the gradient of the loss of task l. The weights c >= 0 of sum 1 that minimise ‖Σ c_l g_l‖² give a direction
that descends for all tasks, or 0 where no direction does: a Pareto-optimal point. (Sener & Koltun 2018, Multi-Task
Learning as Multi-Objective Optimization, Eq. 3 and Algorithm 2; MiDaS weighs its data sets this way, paper section
3.1.) Only the products G_kl = g_k · g_l matter.
"""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from zoedepth.errors import InputError

Normalizer = Literal["none", "l2", "loss", "loss+"]
"""The divisor of each gradient: 1, its norm, its loss, or both."""


def min_norm_weights(
    gram: Float[Tensor, "tasks tasks"], *, max_iterations: int = 250, tolerance: float = 1e-5
) -> Float[Tensor, " tasks"]:
    """Find the weights of the shortest vector in the convex hull of the gradients, from their products.

    Two tasks have a closed form. More are solved by pairwise Frank-Wolfe from the best pair: each step moves weight
    from the task whose gradient the mixture follows most to the one it follows least, as far as that helps
    (Lacoste-Julien & Jaggi 2015). Steps that are not pairwise, as in Sener & Koltun's code, leave weights off by up to
    0.02 after its 250 iterations.

    Args:
        gram: products of the gradients, symmetric.
        max_iterations: largest number of Frank-Wolfe's steps.
        tolerance: the steps end when those two gradients' products with the mixture differ by less than this share of
            the mixture's squared norm.

    Returns:
        float64, >= 0, sum 1.

    Raises:
        InputError: a product is not finite.
    """
    gram = gram.double()
    if not gram.isfinite().all():
        raise InputError(
            "the products of the tasks' gradients are not finite: a loss or a gradient has overflowed. "
            "Lower the learning rate, or train in float32."
        )
    n = len(gram)
    weights = torch.zeros(n, dtype=torch.float64, device=gram.device)
    if n == 1:
        return weights + 1
    # Only ratios matter.
    gram = gram / gram.diagonal().mean().clamp(min=1e-300)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    shares = [_first_share(gram[i, i], gram[i, j], gram[j, j]) for i, j in pairs]
    norms = [
        share**2 * gram[i, i] + 2 * share * (1 - share) * gram[i, j] + (1 - share) ** 2 * gram[j, j]
        for (i, j), share in zip(pairs, shares, strict=True)
    ]
    best = int(torch.stack(norms).argmin())
    (i, j), share = pairs[best], shares[best]
    weights[i], weights[j] = share, 1 - share
    if n == 2:
        return weights
    for _ in range(max_iterations):
        products = gram @ weights
        steepest = int(products.argmin())
        flattest = int(products.masked_fill(weights == 0, -torch.inf).argmax())
        gap = products[flattest] - products[steepest]
        if gap <= tolerance * (weights @ products) + 1e-12:
            break
        bend = gram[steepest, steepest] + gram[flattest, flattest] - 2 * gram[steepest, flattest]
        moved = torch.minimum(gap / bend.clamp(min=1e-300), weights[flattest])
        weights[steepest] += moved
        weights[flattest] -= moved
    return weights


def _first_share(v11: Tensor, v12: Tensor, v22: Tensor) -> Tensor:
    """Return the share of the first of two vectors in their shortest mixture, from their products."""
    if v12 >= v11:
        return torch.ones_like(v11)
    if v12 >= v22:
        return torch.zeros_like(v11)
    return (v22 - v12) / (v11 + v22 - 2 * v12)


def normalized(
    gram: Float[Tensor, "tasks tasks"], losses: Float[Tensor, " tasks"], normalizer: Normalizer
) -> Float[Tensor, "tasks tasks"]:
    """Return the products of the gradients after each gradient is divided by its normalizer."""
    scale = torch.ones_like(losses, dtype=torch.float64)
    if normalizer in ("l2", "loss+"):
        scale = scale * gram.diagonal().double().clamp(min=1e-30).sqrt()
    if normalizer in ("loss", "loss+"):
        scale = scale * losses.double().clamp(min=1e-12)
    return gram.double() / scale.outer(scale)
