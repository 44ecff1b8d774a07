"""Chamfer distances between bins and true depths, against plain loops."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from zoedepth.losses import bins_chamfer, chamfer, window_bins_chamfer

Loss = Callable[..., Tensor]


def by_loops(centers: Tensor, points: Tensor) -> Tensor:
    """Of one set of centers and one of points: every distance, one by one."""
    to_points = [torch.stack([(c - x) ** 2 for x in points]).min() for c in centers]
    to_centers = [torch.stack([(c - x) ** 2 for c in centers]).min() for x in points]
    return torch.stack(to_points).mean() + torch.stack(to_centers).mean()


def scene(*, batch: int = 3, size: tuple[int, int] = (6, 7), known: float = 0.7) -> tuple[Tensor, Tensor]:
    """Depths up to 10 m, NaN where they are unknown, and where they are known."""
    generator = torch.Generator().manual_seed(0)
    target, chance = (torch.rand(batch, 1, *size, generator=generator) for _ in range(2))
    return (10 * target).masked_fill(chance >= known, torch.nan), chance < known


def random_bins(*shape: int) -> Tensor:
    """Unsorted bin centers, some of them beyond all depths."""
    return (14 * torch.rand(*shape, generator=torch.Generator().manual_seed(1)) - 2).requires_grad_()


def split_in_two(loss: Loss, first: tuple, second: tuple) -> Tensor:
    """The loss of two processes: what the second gets once both have given their sums."""
    sums: list[Tensor] = []

    def remember(x: Tensor) -> Tensor:
        sums.append(x)
        return x

    loss(*first, total=remember)
    others = iter(sums)
    value = loss(*second, total=lambda x: x + next(others))
    assert next(others, None) is None
    return value


# --- chamfer ----------------------------------------------------------------------------------------------------------


def test_chamfer_by_hand():
    # Centers 1 and 3, depths 1 and 2: 0 and 1 from centers to depths, 0 and 1 back, the mean of each.
    loss = chamfer(torch.tensor([[3.0, 1.0]]), torch.tensor([[2.0, 1.0]]), torch.ones(1, 2, dtype=torch.bool))
    assert loss.item() == pytest.approx(0.5 + 0.5)


@pytest.mark.parametrize("n_bins", [1, 2, 9])
@pytest.mark.parametrize("n_points", [1, 2, 5])
def test_chamfer_and_its_gradient_are_those_of_plain_loops(n_bins: int, n_points: int):
    centers, points = random_bins(4, n_bins), 10 * torch.rand(4, 5, generator=torch.Generator().manual_seed(2))
    known = torch.zeros(4, 5, dtype=torch.bool)
    for row in range(4):  # each row knows other points
        known[row, [(row + i) % 5 for i in range(n_points)]] = True
    loss = chamfer(centers, points.masked_fill(~known, torch.nan), known)
    expected = torch.stack([by_loops(c, x[k]) for c, x, k in zip(centers, points, known, strict=True)])
    assert torch.allclose(loss, expected, atol=1e-5)
    weights = torch.tensor([1.0, -2.0, 3.0, 0.5])
    found, wanted = (torch.autograd.grad(x @ weights, centers)[0] for x in (loss, expected))
    assert torch.allclose(found, wanted, atol=1e-5)


def test_row_without_points_is_finite_and_leaves_the_others_alone():
    centers, points = random_bins(2, 4), torch.tensor([[torch.nan, torch.nan], [1.0, 2.0]])
    loss = chamfer(centers, points, torch.tensor([[False, False], [True, True]]))
    assert loss.isfinite().all()
    assert loss[1].item() == pytest.approx(by_loops(centers[1], points[1]).item(), rel=1e-5)
    loss[1].backward()
    assert centers.grad.isfinite().all()


# --- bins of whole images ---------------------------------------------------------------------------------------------


def test_bins_of_images_are_compared_with_the_known_depths_of_each():
    (target, mask), centers = scene(), random_bins(3, 5)
    expected = torch.stack([by_loops(c, t[m]) for c, t, m in zip(centers, target, mask, strict=True)]).mean()
    loss = bins_chamfer(centers, target, mask)
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)
    found, wanted = (torch.autograd.grad(x, centers)[0] for x in (loss, expected))
    assert torch.allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("unknown", [0, 1, 2])
def test_image_without_known_depth_does_not_count(unknown: int):
    (target, mask), centers = scene(), random_bins(3, 5)
    mask[unknown] = False
    loss = bins_chamfer(centers, target, mask)
    others = [by_loops(centers[i], target[i][mask[i]]).item() for i in range(3) if i != unknown]
    assert loss.item() == pytest.approx(sum(others) / 2, rel=1e-5)
    loss.backward()
    assert [bool(gradient.any()) for gradient in centers.grad] == [i != unknown for i in range(3)]


def test_no_known_depth_at_all_is_no_loss():
    (target, mask), centers = scene(batch=2), random_bins(2, 5)
    loss = bins_chamfer(centers, target, torch.zeros_like(mask))
    loss.backward()
    assert loss.item() == 0
    assert (centers.grad == 0).all()


def test_bins_at_every_depth_are_no_distance():
    target = torch.tensor([[[[1.0, 2.0, 4.0]]]])
    assert bins_chamfer(torch.tensor([[4.0, 1.0, 2.0]]), target, target > 0).item() == 0


def test_many_depths_are_represented_by_evenly_spread_ones():
    target, mask = scene(batch=1, size=(5, 8), known=2.0)
    centers = random_bins(1, 6)
    loss = bins_chamfer(centers, target, mask, max_points=10)
    assert loss.item() == pytest.approx(by_loops(centers[0], target.flatten()[::4]).item(), rel=1e-5)


def test_a_photo_has_fewer_points_than_pixels_and_nearly_the_same_loss():
    target = torch.linspace(1, 9, 160 * 208).reshape(1, 1, 160, 208)
    centers = torch.linspace(1, 9, 5)[None]
    loss, whole = (bins_chamfer(centers, target, target > 0, max_points=n) for n in (2**14, 2**20))
    assert bins_chamfer(centers, target, target > 0).item() == loss.item()
    # Evenly spread between centers 2 m apart: the mean square of [-1, 1] is a third.
    assert loss.item() == pytest.approx(1 / 3, rel=1e-2)
    assert loss.item() == pytest.approx(whole.item(), rel=1e-2)


def test_bins_of_several_processes_are_one_batch():
    (target, mask), centers = scene(batch=4), random_bins(4, 5)
    mask[3] = False
    parts = [(centers[rows], target[rows], mask[rows]) for rows in (slice(0, 1), slice(1, 4))]
    whole = bins_chamfer(centers, target, mask)
    assert split_in_two(bins_chamfer, *parts).item() == pytest.approx(whole.item(), rel=1e-5)


# --- bins of windows --------------------------------------------------------------------------------------------------

SIZE = (9, 12)
SIDES = (1, 3, 5, 7, 9)


def windows(*, batch: int = 2, n: int = 3) -> tuple[list[list[tuple[int, int, int]]], Tensor]:
    """(left, top, side) of windows of each image, in pixels, smallest first; and their boxes."""
    generator = torch.Generator().manual_seed(3)

    def draw(end: int) -> int:
        return int(torch.randint(end + 1, (), generator=generator))

    places = [
        [(draw(SIZE[1] - side), draw(SIZE[0] - side), side) for side in SIDES for _ in range(n)] for _ in range(batch)
    ]
    width, height = SIZE[1], SIZE[0]
    boxes = [
        [(left / width, top / height, (left + side) / width, (top + side) / height) for left, top, side in image]
        for image in places
    ]
    return places, torch.tensor(boxes)


def windows_by_loops(
    places: list[list[tuple[int, int, int]]], centers: tuple[Tensor, ...], target: Tensor, mask: Tensor, gamma: float
) -> Tensor:
    """The loss, window by window."""
    total = torch.zeros(())
    for i, level in enumerate(centers):
        by_size: dict[int, list[Tensor]] = {side: [] for side in SIDES}
        for image, rows in enumerate(places):
            for window, (left, top, side) in enumerate(rows):
                inside = (image, 0, slice(top, top + side), slice(left, left + side))
                points = target[inside][mask[inside]]
                if len(points) > 0.5 * side**2:
                    by_size[side].append(by_loops(level[image, window], points))
        weights = {side: gamma**rank for rank, side in enumerate(SIDES) if by_size[side]}
        if weights:
            losses = [weight * torch.stack(by_size[side]).mean() for side, weight in weights.items()]
            total = total + gamma ** (len(centers) - 1 - i) * torch.stack(losses).sum() / sum(weights.values())
    return total


@pytest.mark.parametrize("known", [0.95, 0.55])
@pytest.mark.parametrize("gamma", [0.3, 1.0])
def test_window_loss_and_its_gradient_are_those_of_plain_loops(known: float, gamma: float):
    (target, mask), (places, boxes) = scene(batch=2, size=SIZE, known=known), windows()
    centers = tuple(random_bins(2, 15, n) for n in (2, 4, 8))
    loss = window_bins_chamfer(boxes, centers, target, mask, gamma=gamma)
    expected = windows_by_loops(places, centers, target, mask, gamma)
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)
    for found, wanted in zip(*(torch.autograd.grad(x, centers) for x in (loss, expected)), strict=True):
        assert torch.allclose(found, wanted, atol=1e-6)


def one_window_a_size(*depths: float) -> tuple[Tensor, Tensor]:
    """Boxes of five sizes, and a photo where each sees another depth only: 1x1, 2x2, ... 5x5 side by side."""
    boxes, target = [], torch.full((1, 1, 5, 15), torch.nan)
    left = 0
    for side, depth in enumerate(depths, start=1):
        boxes.append((left / 15, 0.0, (left + side) / 15, side / 5))
        target[0, 0, :side, left : left + side] = depth
        left += side
    return torch.tensor([boxes]), target


def test_smaller_windows_and_finer_levels_weigh_more_by_hand():
    """A bin of 0 m, depths sqrt(1 / 2), 0, 0, 0, 0: distances 1, 0, 0, 0, 0 with their weights."""
    boxes, target = one_window_a_size(math.sqrt(0.5), 0.0, 0.0, 0.0, 0.0)
    sizes = 1 + 0.3 + 0.3**2 + 0.3**3 + 0.3**4
    zeros = torch.zeros(1, 5, 1)
    alone = window_bins_chamfer(boxes, (zeros,), target, target.isfinite())
    assert alone.item() == pytest.approx(1 / sizes, rel=1e-5)
    four = window_bins_chamfer(boxes, (zeros,) * 4, target, target.isfinite())
    assert four.item() == pytest.approx((1 + 0.3 + 0.09 + 0.027) / sizes, rel=1e-5)
    # Right at the finest level only: the others are left.
    right = torch.tensor([math.sqrt(0.5), 0.0, 0.0, 0.0, 0.0]).reshape(1, 5, 1)
    coarse = window_bins_chamfer(boxes, (zeros, zeros, zeros, right), target, target.isfinite())
    assert coarse.item() == pytest.approx((0.3 + 0.09 + 0.027) / sizes, rel=1e-5)


def test_size_without_windows_that_count_has_no_weight():
    boxes, target = one_window_a_size(math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0, 0.0)
    target[0, 0, 0, 0] = torch.nan  # the smallest window
    loss = window_bins_chamfer(boxes, (torch.zeros(1, 5, 1),), target, target.isfinite())
    assert loss.item() == pytest.approx(0.3 / (0.3 + 0.3**2 + 0.3**3 + 0.3**4), rel=1e-5)


def test_window_needs_more_than_half_of_its_pixels():
    boxes, target = one_window_a_size(torch.nan, math.sqrt(0.5), torch.nan, torch.nan, torch.nan)
    centers = (torch.zeros(1, 5, 1, requires_grad=True),)
    target[0, 0, 0, 1] = torch.nan  # 3 of 4 are left
    assert window_bins_chamfer(boxes, centers, target, target.isfinite()).item() == pytest.approx(1, rel=1e-5)
    target[0, 0, 0, 2] = torch.nan  # 2 of 4
    loss = window_bins_chamfer(boxes, centers, target, target.isfinite())
    loss.backward()
    assert loss.item() == 0
    assert (centers[0].grad == 0).all()


@pytest.mark.parametrize(
    ("left", "right", "points"),
    [(0.7, 1.7, [2.0]), (-3.0, 6.0, [1.0, 1.0, 1.0, 1.0, 2.0, 4.0, 4.0, 4.0, 4.0])],
    ids=["between pixels", "over the border"],
)
def test_window_reads_the_pixel_at_the_middle_of_each_of_its_columns(left: float, right: float, points: list[float]):
    target = torch.tensor([[[[1.0, 2.0, 4.0]]]])
    box, center = torch.tensor([[[left / 3, 0.0, right / 3, 1.0]]]), torch.zeros(1, 1, 1)
    loss = window_bins_chamfer(box, (center,), target, target > 0, n_sizes=1)
    assert loss.item() == pytest.approx(min(points) ** 2 + sum(x**2 for x in points) / len(points), rel=1e-5)


def test_windows_of_several_processes_are_one_batch():
    (target, mask), (_, boxes) = scene(batch=3, size=SIZE, known=0.6), windows(batch=3)
    centers = tuple(random_bins(3, 15, n) for n in (2, 4))
    mask[0, :, :, :6] = False  # so that processes have different numbers of windows
    parts = [
        (boxes[rows], tuple(x[rows] for x in centers), target[rows], mask[rows]) for rows in (slice(0, 2), slice(2, 3))
    ]
    whole = window_bins_chamfer(boxes, centers, target, mask)
    assert split_in_two(window_bins_chamfer, *parts).item() == pytest.approx(whole.item(), rel=1e-5)


def test_half_precision_is_computed_in_float32():
    (target, mask), (_, boxes) = scene(batch=2, size=SIZE), windows()
    rough = random_bins(2, 15, 4).detach().bfloat16()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = window_bins_chamfer(boxes, (rough,), target, mask), bins_chamfer(rough[:, 0], target, mask)
    exact = window_bins_chamfer(boxes, (rough.float(),), target, mask), bins_chamfer(rough[:, 0].float(), target, mask)
    for value, expected in zip(found, exact, strict=True):
        assert value.dtype == torch.float32
        assert value.item() == pytest.approx(expected.item(), rel=1e-5)
