"""Each equation of the paper, and of the released models where they add to it, against a loop over plain numbers."""

import math

import pytest
import torch

from zoedepth.model.beit import relative_position_index, resize_position_table
from zoedepth.model.heads.attractor import attract, exponential_attractor, inverse_attractor, normed_centers
from zoedepth.model.heads.probability import LogBinomial, expected_depth, log_binomial, log_binomial_coefficients


def random_numbers(*shape: int, low: float = 0.0, high: float = 1.0) -> torch.Tensor:
    return low + (high - low) * torch.rand(*shape, generator=torch.Generator().manual_seed(sum(shape)))


def test_expected_depth_is_equation_1():
    probability, centers = random_numbers(2, 3, 4, 5), random_numbers(2, 3, 4, 5, low=0.5, high=9)
    depth = expected_depth(probability, centers)
    assert depth.shape == (2, 3, 4)
    for b in range(2):
        for y in range(3):
            for x in range(4):
                expected = sum(probability[b, y, x, k].item() * centers[b, y, x, k].item() for k in range(5))
                assert depth[b, y, x].item() == pytest.approx(expected, rel=1e-5)


def test_inverse_attractor_by_hand():
    # 0.1 / (1 + 300 * 0.01) = 0.025; the same with the sign turned; nothing at no distance.
    pull = inverse_attractor(torch.tensor([0.1, -0.1, 0.0]), alpha=300.0, gamma=2.0)
    assert pull.tolist() == pytest.approx([0.025, -0.025, 0.0])


def test_exponential_attractor_by_hand():
    # 0.5 exp(-4 * 0.25) = 0.5 / e
    pull = exponential_attractor(torch.tensor([0.5, -0.5, 0.0]), alpha=4.0, gamma=2.0)
    assert pull.tolist() == pytest.approx([0.5 / math.e, -0.5 / math.e, 0.0])


def test_odd_exponent_takes_the_distance_without_its_sign():
    # 0.2 / (1 + 5 * 0.008) on either side; 0.2 exp(-5 * 0.008)
    distance = torch.tensor([0.2, -0.2])
    assert inverse_attractor(distance, alpha=5.0, gamma=3.0).tolist() == pytest.approx([0.2 / 1.04, -0.2 / 1.04])
    pull = 0.2 * math.exp(-0.04)
    assert exponential_attractor(distance, alpha=5.0, gamma=3.0).tolist() == pytest.approx([pull, -pull])


@pytest.mark.parametrize(("alpha", "gamma"), [(300.0, 2.0), (3.0, 1.0), (1.0, 2.5)])
@pytest.mark.parametrize("reduce", ["sum", "mean"])
@pytest.mark.parametrize("kind", ["inverse", "exponential"])
def test_attract_is_equations_2_and_3(kind: str, reduce: str, alpha: float, gamma: float):
    bins, points, height, width = 4, 3, 2, 3
    centers, attractors = random_numbers(2, bins, height, width), random_numbers(2, points, height, width)
    moved = attract(centers, attractors, kind=kind, reduce=reduce, alpha=alpha, gamma=gamma)
    for b in range(2):
        for y in range(height):
            for x in range(width):
                for i in range(bins):
                    c = centers[b, i, y, x].item()
                    delta = 0.0
                    for k in range(points):
                        a = attractors[b, k, y, x].item()
                        if kind == "inverse":
                            delta += (a - c) / (1 + alpha * abs(a - c) ** gamma)
                        else:
                            delta += (a - c) * math.exp(-alpha * abs(a - c) ** gamma)
                    delta /= points if reduce == "mean" else 1
                    assert moved[b, i, y, x].item() == pytest.approx(c + delta, abs=1e-5)


def test_attracting_leaves_its_input_alone():
    centers, attractors = random_numbers(1, 4, 2, 2), random_numbers(1, 3, 2, 2)
    before = centers.clone()
    attract(centers, attractors, kind="inverse", reduce="sum", alpha=300.0, gamma=2.0)
    assert torch.equal(centers, before)


def stirling(n: float, k: float) -> float:
    """ln C(n, k) by ln x! ~ x ln x - x, with the released shifts that keep the logarithms finite."""
    n, k = n + 1e-7, k + 1e-7
    return n * math.log(n) - k * math.log(k) - (n - k) * math.log(n - k + 1e-7)


@pytest.mark.parametrize("n_bins", [2, 8, 64])
def test_coefficients_are_stirling_of_the_released_models(n_bins: int):
    expected = [stirling(n_bins - 1, k) for k in range(n_bins)]
    assert log_binomial_coefficients(n_bins).tolist() == pytest.approx(expected, abs=1e-4)


def test_coefficients_approach_the_true_binomial():
    # The leading term misses ln sqrt(2 pi n x (1 - x)), x = k / n: at n = 63, k = 31 that is ln 9.947 = 2.297.
    coefficients = log_binomial_coefficients(64)
    assert coefficients[31].item() - math.log(math.comb(63, 31)) == pytest.approx(
        math.log(math.sqrt(2 * math.pi * 31 * 32 / 63)), abs=0.01
    )
    assert coefficients[0].item() == pytest.approx(0, abs=1e-4)
    assert coefficients[63].item() == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("t", [0.0212, 0.3, 1.0, 50.0])
@pytest.mark.parametrize("q", [0.0, 1e-5, 0.1, 0.5, 0.73, 1.0])
def test_log_binomial_is_equation_4_and_softmax_with_temperature(q: float, t: float):
    n = 15
    found = log_binomial(torch.full((1, 1, 1, 1), q), torch.full((1, 1, 1, 1), t), log_binomial_coefficients(n + 1))
    low, high = max(q, 1e-4), max(1 - q, 1e-4)
    logits = [(stirling(n, k) + k * math.log(low) + (n - k) * math.log(high)) / t for k in range(n + 1)]
    weights = [math.exp(logit - max(logits)) for logit in logits]
    assert found.shape == (1, n + 1, 1, 1)
    assert found.flatten().tolist() == pytest.approx([w / sum(weights) for w in weights], abs=3e-5)


def test_log_binomial_takes_each_pixel_by_itself():
    coefficients = log_binomial_coefficients(8)
    q, t = random_numbers(2, 1, 3, 2), random_numbers(2, 1, 3, 2, low=0.1, high=3)
    together = log_binomial(q, t, coefficients)
    for b in range(2):
        for y in range(3):
            for x in range(2):
                alone = log_binomial(q[b, 0, y, x].view(1, 1, 1, 1), t[b, 0, y, x].view(1, 1, 1, 1), coefficients)
                assert torch.allclose(together[b, :, y, x], alone.flatten(), atol=1e-6)


@pytest.mark.parametrize("q", [0.02, 0.31, 0.5, 0.88])
def test_log_binomial_has_one_mode_that_q_places(q: float):
    p = log_binomial(torch.full((1, 1, 1, 1), q), torch.ones(1, 1, 1, 1), log_binomial_coefficients(64)).flatten()
    mode = int(p.argmax())
    assert abs(mode - 63 * q) <= 1
    steps = p.diff()
    assert (steps[:mode] >= 0).all()
    assert (steps[mode:] <= 0).all()


def test_lower_temperature_is_sharper():
    coefficients, q = log_binomial_coefficients(64), torch.full((1, 1, 1, 1), 0.4)
    peaks = [log_binomial(q, torch.full((1, 1, 1, 1), t), coefficients).max().item() for t in (0.05, 0.5, 5.0)]
    assert peaks[0] > peaks[1] > peaks[2]


def test_released_predictor_of_q_and_t():
    """ConditionalLogBinomial: an MLP with GELU and softplus gives four numbers; two make q, two make t."""
    low, high, n_bins = 0.0212, 50.0, 8
    torch.manual_seed(0)
    predictor = LogBinomial(6, n_bins, bottleneck_factor=2, min_temperature=low, max_temperature=high)
    x = torch.randn(1, 6, 1, 1)
    first, second = predictor.mlp[0], predictor.mlp[2]
    hidden = []
    for row, bias in zip(first.weight.flatten(1).tolist(), first.bias.tolist(), strict=True):
        value = sum(w * v for w, v in zip(row, x.flatten().tolist(), strict=True)) + bias
        hidden.append(value * 0.5 * (1 + math.erf(value / math.sqrt(2))))
    s = []
    for row, bias in zip(second.weight.flatten(1).tolist(), second.bias.tolist(), strict=True):
        s.append(math.log1p(math.exp(sum(w * v for w, v in zip(row, hidden, strict=True)) + bias)))
    assert len(hidden) == 3
    assert len(s) == 4
    q = (s[0] + 1e-4) / ((s[0] + 1e-4) + (s[1] + 1e-4))
    t = (high - low) * (s[2] + 1e-4) / ((s[2] + 1e-4) + (s[3] + 1e-4)) + low
    n = n_bins - 1
    weights = [math.exp((stirling(n, k) + k * math.log(q) + (n - k) * math.log(1 - q)) / t) for k in range(n_bins)]
    assert predictor([x], torch.ones(1, 1, 1, 1)).probability.flatten().tolist() == pytest.approx(
        [w / sum(weights) for w in weights], abs=1e-5
    )


def test_normed_centers_are_the_middles_of_the_bins():
    widths = random_numbers(2, 5, 2, 3, low=0.001, high=4)
    centers = normed_centers(widths)
    for b in range(2):
        for y in range(2):
            for x in range(3):
                column = widths[b, :, y, x].tolist()
                edge = 0.0
                for i, width in enumerate(column):
                    share = width / sum(column)
                    assert centers[b, i, y, x].item() == pytest.approx(edge + share / 2, abs=1e-6)
                    edge += share


@pytest.mark.parametrize("grid", [(1, 1), (2, 3), (3, 2), (4, 4)])
def test_relative_position_index_of_every_pair_of_tokens(grid: tuple[int, int]):
    height, width = grid
    n = (2 * height - 1) * (2 * width - 1) + 3
    tokens = [(y, x) for y in range(height) for x in range(width)]
    index = relative_position_index(grid)
    assert index.shape == (len(tokens) + 1, len(tokens) + 1)
    for i, (query_y, query_x) in enumerate(tokens, start=1):
        assert index[0, i] == n - 3, "the class token asks"
        assert index[i, 0] == n - 2, "the class token is asked"
        for j, (key_y, key_x) in enumerate(tokens, start=1):
            down, right = query_y - key_y, query_x - key_x
            assert index[i, j] == (down + height - 1) * (2 * width - 1) + (right + width - 1)
    assert index[0, 0] == n - 1


def resize_line(values: list[float], length: int) -> list[float]:
    """Bilinear, pixels at their middles (``align_corners=False``), borders repeated, no filter."""
    out = []
    for i in range(length):
        place = min(max((i + 0.5) * len(values) / length - 0.5, 0.0), len(values) - 1.0)
        left = int(place)
        right = min(left + 1, len(values) - 1)
        out.append(values[left] + (place - left) * (values[right] - values[left]))
    return out


@pytest.mark.parametrize("grid", [(2, 4), (5, 3), (3, 3), (1, 6)])
def test_position_table_is_resized_as_a_picture_and_keeps_the_class_token(grid: tuple[int, int]):
    native, heads = (3, 4), 2
    table = random_numbers((2 * 3 - 1) * (2 * 4 - 1) + 3, heads, low=-1)
    resized = resize_position_table(table, native, grid)
    height, width = 2 * grid[0] - 1, 2 * grid[1] - 1
    assert resized.shape == (height * width + 3, heads)
    for head in range(heads):
        picture = table[:-3, head].reshape(5, 7).tolist()
        wide = [resize_line(line, width) for line in picture]
        columns = [resize_line([line[x] for line in wide], height) for x in range(width)]
        expected = [columns[x][y] for y in range(height) for x in range(width)]
        assert resized[:-3, head].tolist() == pytest.approx(expected, abs=1e-5)
    assert torch.equal(resized[-3:], table[-3:])


def test_position_table_of_the_native_grid_is_unchanged():
    table = random_numbers(5 * 7 + 3, 2)
    assert torch.equal(resize_position_table(table, (3, 4), (3, 4)), table)
