"""MGDA against geometry one can see, and against another solver."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from zoedepth.errors import InputError
from zoedepth.pareto import min_norm_weights, normalized


def weights_of(*gradients: list[float]) -> list[float]:
    g = torch.tensor(gradients, dtype=torch.float64)
    return min_norm_weights(g @ g.T).tolist()


def test_one_task_has_all_the_weight():
    assert weights_of([3.0, 4.0]) == [1.0]


def test_orthogonal_gradients_of_one_length_share_equally():
    assert weights_of([1.0, 0.0], [0.0, 1.0]) == [0.5, 0.5]


def test_opposite_gradients_cancel():
    """2 to the right and 1 to the left: a third and two thirds."""
    assert weights_of([2.0, 0.0], [-1.0, 0.0]) == pytest.approx([1 / 3, 2 / 3])


def test_the_shorter_of_two_in_one_direction_has_all_the_weight():
    assert weights_of([1.0, 1.0], [10.0, 10.0]) == [1.0, 0.0]
    assert weights_of([10.0, 10.0], [1.0, 1.0]) == [0.0, 1.0]


def test_three_orthogonal_gradients_weigh_by_inverse_squares():
    """Norms 1, 2, 4: weights as 16 : 4 : 1."""
    found = weights_of([1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0])
    assert found == pytest.approx([16 / 21, 4 / 21, 1 / 21], abs=1e-6)


def test_point_inside_the_hull_has_norm_zero():
    gradients = torch.tensor([[1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]], dtype=torch.float64)
    weights = min_norm_weights(gradients @ gradients.T)
    assert (weights @ gradients).norm().item() < 1e-3


def test_all_gradients_zero_is_no_error():
    found = min_norm_weights(torch.zeros(3, 3))
    assert found.sum() == 1
    assert (found >= 0).all()


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_products_that_are_not_finite_are_an_error(value: float):
    with pytest.raises(InputError, match="not finite"):
        min_norm_weights(torch.tensor([[1.0, value], [value, 1.0]]))


def projected_gradient(gram: Tensor, steps: int = 3000) -> Tensor:
    """Another way to the same weights: gradient steps, each followed by the nearest point of the simplex."""
    n = len(gram)
    weights = torch.full((n,), 1 / n, dtype=torch.float64)
    rate = 1 / torch.linalg.eigvalsh(gram)[-1]
    for _ in range(steps):
        moved = weights - rate * gram @ weights
        ordered = moved.sort(descending=True).values
        excess = (ordered.cumsum(0) - 1) / torch.arange(1, n + 1)
        weights = (moved - excess[(ordered > excess).nonzero()[-1, 0]]).clamp(min=0)
    return weights


@pytest.mark.parametrize("seed", range(4))
def test_frank_wolfe_agrees_with_projected_gradients_on_twelve_tasks(seed: int):
    generator = torch.Generator().manual_seed(seed)
    gradients = torch.randn(12, 40, generator=generator, dtype=torch.float64)
    gradients *= 0.5 + torch.rand(12, 1, generator=generator, dtype=torch.float64)
    gram = gradients @ gradients.T
    found = min_norm_weights(gram)
    assert found.sum().item() == pytest.approx(1)
    assert (found - projected_gradient(gram)).abs().max() < 1e-3


def similar_gradients(seed: int, n: int = 5) -> Tensor:
    """Gradients that are closer than right angles, of similar lengths: mixtures of pairs differ little."""
    generator = torch.Generator().manual_seed(seed)
    gradients = 1 + torch.randn(n, 40, generator=generator, dtype=torch.float64)
    lengths = 1 + 0.2 * torch.rand(n, 1, generator=generator, dtype=torch.float64)
    return lengths * gradients / gradients.norm(dim=1, keepdim=True)


@pytest.mark.parametrize("seed", range(8))
def test_the_steps_begin_at_the_pair_with_the_shortest_mixture(seed: int):
    gradients = similar_gradients(seed)
    lengths = {
        (i, j): min(float((share * g + (1 - share) * h).norm()) for share in torch.linspace(0, 1, 501))
        for i, g in enumerate(gradients)
        for j, h in enumerate(gradients)
        if i < j
    }
    found = min_norm_weights(gradients @ gradients.T, max_iterations=0)
    i, j = min(lengths, key=lambda pair: lengths[pair])
    assert float(found[i] + found[j]) == pytest.approx(1)
    assert float((found @ gradients).norm()) == pytest.approx(lengths[i, j], abs=1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_a_step_goes_as_far_as_it_helps(seed: int):
    """It ends where the mixture is shortest on its line, or where the task that gives weight has none left."""
    gradients = similar_gradients(seed)
    gram = gradients @ gradients.T
    before, after = min_norm_weights(gram, max_iterations=0), min_norm_weights(gram, max_iterations=1)
    moved = after - before
    to, origin = int(moved.argmax()), int(moved.argmin())
    slope = float((gradients[to] - gradients[origin]) @ (after @ gradients))
    assert moved[to] > 0
    assert slope == pytest.approx(0, abs=1e-9) or (after[origin] == 0 and slope < 0)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 12), size=st.integers(1, 30), scale=st.floats(1e-6, 1e6))
def test_no_task_gets_worse(seed: int, n: int, size: int, scale: float):
    """The mixture has a product >= its own squared norm with every gradient: the mark of the minimum."""
    gradients = torch.randn(n, size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * scale
    gram = gradients @ gradients.T
    weights = min_norm_weights(gram)
    assert weights.sum().item() == pytest.approx(1)
    assert (weights >= 0).all()
    mixture = weights @ gradients
    slack = 1e-2 * gram.diagonal().mean()
    assert ((gradients @ mixture) >= mixture.square().sum() - slack).all()


def test_normalizers_divide_the_gradients():
    gram = torch.tensor([[4.0, 2.0], [2.0, 9.0]])
    losses = torch.tensor([2.0, 5.0])
    expected = {
        "none": [[4, 2], [2, 9]],
        "l2": [[1, 2 / 6], [2 / 6, 1]],
        "loss": [[1, 0.2], [0.2, 9 / 25]],
        "loss+": [[1 / 4, 1 / 30], [1 / 30, 1 / 25]],
    }
    for name, values in expected.items():
        found = normalized(gram, losses, name)
        torch.testing.assert_close(found, torch.tensor(values, dtype=torch.float64))


def test_normalizers_divide_small_gradients_and_losses_too():
    gram = torch.tensor([[0.04, 0.02], [0.02, 0.09]])
    found = normalized(gram, torch.tensor([0.2, 0.5]), "loss+")
    torch.testing.assert_close(found, torch.tensor([[25, 10 / 3], [10 / 3, 4]], dtype=torch.float64))
