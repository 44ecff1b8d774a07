"""DORN's ordinal loss."""

import math

import pytest
import torch

from zoedepth.losses import ordinal

EDGES = torch.tensor([1.0, 2.0, 4.0, 8.0])


def plain(logits: torch.Tensor, edges: torch.Tensor, target: torch.Tensor, mask: torch.Tensor) -> float:
    """The paper's Eqs. 3 and 4, a pixel and an interval at a time; maps of one size."""
    total, n = 0.0, 0
    for b in range(len(target)):
        for i in range(target.shape[2]):
            for j in range(target.shape[3]):
                if not mask[b, 0, i, j]:
                    continue
                depth, n = target[b, 0, i, j].item(), n + 1
                for k in range(logits.shape[1]):
                    beyond = 1 / (1 + math.exp(-logits[b, k, i, j].item()))
                    total -= math.log(beyond) if depth >= edges[b, k + 1] else math.log(1 - beyond)
    return total / n


def test_it_is_a_plain_loop():
    torch.manual_seed(0)
    logits, edges = 2 * torch.randn(2, 3, 4, 5), torch.stack([EDGES, 3 * EDGES])
    target, mask = 30 * torch.rand(2, 1, 4, 5) ** 2, torch.rand(2, 1, 4, 5) < 0.7
    assert ordinal(logits, edges, target, mask).item() == pytest.approx(plain(logits, edges, target, mask), rel=1e-5)


def test_it_by_hand():
    # 3 m lies beyond the first interval only. All probabilities 1/2: three times ln 2.
    target, mask = torch.full((1, 1, 1, 1), 3.0), torch.ones(1, 1, 1, 1, dtype=torch.bool)
    logits = torch.zeros(1, 3, 1, 1, requires_grad=True)
    loss = ordinal(logits, EDGES[None], target, mask)
    loss.backward()
    assert loss.item() == pytest.approx(3 * math.log(2), rel=1e-6)
    assert logits.grad.flatten().tolist() == pytest.approx([-0.5, 0.5, 0.5])


@pytest.mark.parametrize(("depth", "label"), [(1.0, 0), (1.99, 0), (2.0, 1), (3.99, 1), (4.0, 2), (7.99, 2)])
def test_a_depth_is_beyond_as_many_intervals_as_its_label(depth: float, label: int):
    """Where the loss vanishes: logits of the right answer, monotone by nature."""
    target, mask = torch.full((1, 1, 1, 1), depth), torch.ones(1, 1, 1, 1, dtype=torch.bool)
    for guess in range(3):
        logits = torch.where(torch.arange(3) < guess, 30.0, -30.0)[None, :, None, None]
        loss = ordinal(logits, EDGES[None], target, mask).item()
        assert loss == pytest.approx(30.0 * abs(guess - label), abs=1e-6)


def test_each_image_has_edges_of_its_own():
    target, mask = torch.full((2, 1, 1, 1), 3.0), torch.ones(2, 1, 1, 1, dtype=torch.bool)
    logits = torch.tensor([[30.0, -30.0, -30.0], [-30.0, -30.0, -30.0]])[:, :, None, None]
    assert ordinal(logits, torch.stack([EDGES, 10 * EDGES]), target, mask).item() == pytest.approx(0, abs=1e-6)
    assert ordinal(logits, torch.stack([EDGES, EDGES]), target, mask).item() == pytest.approx(15.0)


def test_coarser_logits_read_the_nearest_target_and_its_mask():
    target = torch.tensor([[3.0, 1.5, 7.0, 1.5], [1.5, 1.5, 1.5, 1.5]])[None, None]
    mask = torch.ones_like(target, dtype=torch.bool)
    logits = torch.where(torch.tensor([[0, 0], [1, 1], [2, 2]]) < torch.tensor([1, 2]), 30.0, -30.0)[None, :, None]
    assert ordinal(logits, EDGES[None], target, mask).item() == pytest.approx(0, abs=1e-6)
    target[0, 0, 0, 2] = float("nan")
    mask[0, 0, 0, 2] = False
    assert ordinal(logits, EDGES[None], target, mask).item() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("unknown", [0.0, float("nan"), float("inf"), -1.0])
def test_where_nothing_is_known_it_is_zero_and_so_is_its_gradient(unknown: float):
    logits = torch.randn(2, 3, 2, 2, requires_grad=True)
    target, mask = torch.full((2, 1, 2, 2), unknown), torch.zeros(2, 1, 2, 2, dtype=torch.bool)
    loss = ordinal(logits, EDGES.expand(2, -1), target, mask)
    loss.backward()
    assert loss.item() == 0
    assert (logits.grad == 0).all()


def test_it_is_computed_in_float32_and_stays_finite():
    logits = torch.tensor([[2e3, -2e3, 2e3]], dtype=torch.bfloat16)[:, :, None, None].requires_grad_()
    target, mask = torch.full((1, 1, 1, 1), 3.0), torch.ones(1, 1, 1, 1, dtype=torch.bool)
    loss = ordinal(logits, EDGES[None], target, mask)
    loss.backward()
    assert loss.dtype == torch.float32
    assert loss.item() == pytest.approx(2000)
    assert logits.grad.isfinite().all()


def test_the_mean_is_over_the_pixels_of_all_processes():
    """A process that sees half of the batch, and is told the sums of both."""
    torch.manual_seed(0)
    logits, target = torch.randn(2, 3, 4, 4), 8 * torch.rand(2, 1, 4, 4)
    mask, edges = torch.rand(2, 1, 4, 4) < 0.5, EDGES.expand(2, -1)
    whole = ordinal(logits, edges, target, mask).item()
    sums: list[list[torch.Tensor]] = []
    for half in (slice(0, 1), slice(1, 2)):
        seen: list[torch.Tensor] = []

        def remembered(x: torch.Tensor, seen: list[torch.Tensor] = seen) -> torch.Tensor:
            seen.append(x)
            return x

        ordinal(logits[half], edges[half], target[half], mask[half], total=remembered)
        sums.append(seen)
    (a, n), (b, m) = sums
    assert ((a + b) / (n + m)).item() == pytest.approx(whole, rel=1e-5)
