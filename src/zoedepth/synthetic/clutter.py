"""Small things that stand on surfaces, shelves and floors, each at the origin of its frame."""

import math
from collections.abc import Callable

from zoedepth.synthetic.palette import (
    Random,
    any_color,
    ceramic,
    cloth,
    glass,
    leaves,
    metal,
    mixed,
    pick,
    picture,
    plastic,
    scaled,
    wood,
    writing,
)  # fmt: skip
from zoedepth.synthetic.scene import Frame, Material


def scatter(frame: Frame, rng: Random, width: float, depth: float, count: int) -> None:
    """Put up to ``count`` things on a surface of ``width`` x ``depth`` metres, apart from each other."""
    taken: list[tuple[float, float, float]] = []
    for _ in range(count):
        radius = rng.uniform(0.05, 0.16)
        if width < 2.1 * radius or depth < 2.1 * radius:
            continue
        x, y = rng.uniform(-0.5, 0.5) * (width - 2 * radius), rng.uniform(-0.5, 0.5) * (depth - 2 * radius)
        if all(math.hypot(x - a, y - b) > radius + r for a, b, r in taken):
            taken.append((x, y, radius))
            thing(frame.at(x, y, 0, rng.uniform(-math.pi, math.pi)), rng, radius)


def thing(frame: Frame, rng: Random, radius: float) -> None:
    """Put down a small thing that fits a circle of about ``radius`` metres."""
    put = _THINGS[int(rng.integers(len(_THINGS)))]
    put(frame, rng, radius)


def _vase(frame: Frame, rng: Random, r: float) -> None:
    frame.add("vase", ceramic(rng), (1.1 * r, 1.1 * r, rng.uniform(1.5, 3) * r))
    if rng.random() < 0.6:
        frame.add(pick(rng, "leaves0", "fronds", "tuft"), leaves(rng), (2.2 * r, 2.2 * r, 2.5 * r), (0, 0, 1.8 * r))


def _bottle(frame: Frame, rng: Random, r: float) -> None:
    material = glass(rng) if rng.random() < 0.5 else plastic(rng)
    frame.add("bottle", material, (0.6 * r + 0.03, 0.6 * r + 0.03, rng.uniform(0.18, 0.32)))


def _bowl_of_fruit(frame: Frame, rng: Random, r: float) -> None:
    frame.add("bowl", ceramic(rng), (1.8 * r, 1.8 * r, 0.8 * r))
    for i in range(int(rng.integers(0, 5))):
        color = any_color(rng, saturation=(0.6, 0.9), value=(0.4, 0.9))
        at = (0.4 * r * math.cos(2 * i), 0.4 * r * math.sin(2 * i), 0.45 * r)
        frame.add("sphere", Material("stained", color, (0.5, 0.4, 0.1), 0.1, 0.15), (0.07, 0.07, 0.065), at)


def _cup(frame: Frame, rng: Random, r: float) -> None:
    frame.add("cup", ceramic(rng), (0.085, 0.085, rng.uniform(0.08, 0.12)))
    frame.add("plate", ceramic(rng), (0.15, 0.15, 0.015))


def _books(frame: Frame, rng: Random, r: float) -> None:
    book_pile(frame, rng, int(rng.integers(1, 6)))


def _package(frame: Frame, rng: Random, r: float) -> None:
    height = rng.uniform(0.6, 2.2) * r
    frame.add("box", pick(rng, plastic(rng), writing(rng, 0.03), wood(rng)), (1.3 * r, 1.1 * r, height))


def _ball(frame: Frame, rng: Random, r: float) -> None:
    frame.add("sphere", plastic(rng), (r, r, r))


def _pot_plant(frame: Frame, rng: Random, r: float) -> None:
    frame.add("pot", ceramic(rng), (1.1 * r, 1.1 * r, r))
    name = pick(rng, "leaves1", "spikes", "fronds", "blob1")
    frame.add(name, leaves(rng), (2.4 * r, 2.4 * r, 2.4 * r), (0, 0, 0.8 * r))


def _jar(frame: Frame, rng: Random, r: float) -> None:
    frame.add("jar", pick(rng, ceramic(rng), metal(rng), glass(rng)), (1.1 * r, 1.1 * r, rng.uniform(1, 2) * r))


def _tray(frame: Frame, rng: Random, r: float) -> None:
    frame.add("box", plastic(rng), (2 * r, 1.4 * r, 0.012 + 0.05 * r))
    frame.add("box", writing(rng, 0.012), (1.3 * r, 1.7 * r, 0.004), (0.02, 0.01, 0.012 + 0.05 * r), yaw=0.3)


def _framed_photo(frame: Frame, rng: Random, r: float) -> None:
    frame.add("box", wood(rng), (1.5 * r, 0.02, 1.9 * r), roll=-0.15)
    frame.add("box", picture(rng), (1.3 * r, 0.01, 1.7 * r), (0, -0.012, 0.1 * r), roll=-0.15)


_THINGS: tuple[Callable[[Frame, Random, float], None], ...] = (
    _vase, _bottle, _bowl_of_fruit, _cup, _books, _package, _ball, _pot_plant, _jar, _tray, _framed_photo,
)  # fmt: skip


def book_pile(frame: Frame, rng: Random, count: int) -> None:
    """Pile up books that lie flat."""
    z = 0.0
    for _ in range(count):
        thick = rng.uniform(0.012, 0.05)
        yaw, size = rng.normal(0, 0.2), (rng.uniform(0.13, 0.24), rng.uniform(0.18, 0.3), thick)
        frame.add("box", Material("text", any_color(rng), any_color(rng), 0.035), size, (0, 0, z), yaw=yaw)
        z += thick


def book_row(frame: Frame, rng: Random, width: float, height: float, depth: float) -> None:
    """Stand books in a row from -width/2 to the right; the frame's origin is at the back of the shelf."""
    x, end = -width / 2, -width / 2 + width * rng.uniform(0.5, 1.0)
    series, loose = any_color(rng), rng.random()
    while x < end - 0.06:
        thick = rng.uniform(0.015, 0.055)
        tall, deep = height * rng.uniform(0.6, 0.93), depth * rng.uniform(0.6, 0.85)
        color = any_color(rng, saturation=(0.1, 0.85), value=(0.12, 0.9))
        if loose < 0.3:
            color = mixed(color, series)
        material = Material(pick(rng, "plain", "text", "slats"), color, scaled(color, pick(rng, 0.4, 1.8)), 0.04)
        lean = rng.uniform(0.08, 0.2) if rng.random() < 0.06 else 0.0
        frame.add(
            "box", material, (thick, deep, tall), (x + thick / 2 + lean * tall / 2, -deep / 2 - 0.01, 0), pitch=lean
        )
        x += thick + 0.002 + lean * tall


def shelf_content(frame: Frame, rng: Random, width: float, height: float, depth: float) -> None:
    """Fill one compartment of a shelf, or leave it empty; the frame's origin is at its back."""
    kind = rng.random()
    if kind < 0.5:
        book_row(frame, rng, width, height, depth)
    elif kind < 0.85:
        inner = frame.at(0, -depth / 2)
        for i in range(int(rng.integers(1, 4))):
            radius = min(0.3 * height, 0.4 * depth, 0.13) * rng.uniform(0.6, 1)
            thing(inner.at((i - 1) * width / 3.2 + rng.uniform(-0.03, 0.03), 0, 0, rng.uniform(-0.4, 0.4)), rng, radius)
    elif kind < 0.95:
        for i in (-1, 1):
            size = (0.42 * width, 0.85 * depth, height * rng.uniform(0.5, 0.85))
            frame.add("box", pick(rng, cloth(rng), wood(rng), plastic(rng)), size, (i * width / 4, -depth / 2, 0))


def computer(frame: Frame, rng: Random) -> None:
    """Set up a screen with keyboard and mouse, or a laptop; the user sits at -y."""
    grey = rng.uniform(0.03, 0.2)
    dark = Material("plain", (grey, grey, grey), gloss=0.2)
    on = rng.random() < 0.6
    screen = Material(
        "text" if on else "plain",
        any_color(rng, value=(0.6, 1)) if on else (0.02, 0.02, 0.025),
        (0.1, 0.15, 0.3),
        0.025,
        0.2,
        0.0 if on else 0.12,
        0.8 if on else 0,
    )
    if rng.random() < 0.6:
        width = rng.uniform(0.42, 0.75)
        height = 0.58 * width
        frame.add("cylinder", dark, (0.22, 0.22, 0.012), (0, 0.08, 0))
        frame.add("box", dark, (0.04, 0.03, 0.25), (0, 0.1, 0))
        frame.add("box", dark, (width, 0.03, height), (0, 0.08, 0.12))
        frame.add("box", screen, (width - 0.025, 0.004, height - 0.03), (0, 0.063, 0.135))
        frame.add("box", dark, (0.42, 0.14, 0.02), (0, -0.2, 0))
        frame.add("soft", dark, (0.06, 0.1, 0.035), (0.3, -0.2, 0))
    else:
        shell = pick(rng, dark, Material("plain", (0.6, 0.6, 0.62), gloss=0.3))
        frame.add("box", shell, (0.33, 0.23, 0.016), (0, -0.05, 0))
        frame.add("box", dark, (0.28, 0.11, 0.004), (0, -0.02, 0.015))
        frame.add("box", shell, (0.33, 0.01, 0.22), (0, 0.1, 0.01), roll=-0.3)
        frame.add("box", screen, (0.31, 0.004, 0.2), (0, 0.09, 0.018), roll=-0.3)


def plant(frame: Frame, rng: Random, height: float) -> None:
    """Put a plant of about ``height`` metres on the floor, in a pot."""
    pot = rng.uniform(0.22, 0.4)
    frame.add(pick(rng, "pot", "pot", "vase", "cylinder"), pick(rng, ceramic(rng), wood(rng)), (pot, pot, 0.9 * pot))
    green, top = leaves(rng), height - 0.7 * pot
    kind = rng.random()
    if kind < 0.4:
        width = rng.uniform(0.6, 1.0) * height
        frame.add(pick(rng, "fronds", "spikes"), green, (width, width, top), (0, 0, 0.7 * pot))
    else:
        bark = Material("bark", (0.35, 0.28, 0.2), (0.15, 0.1, 0.08))
        frame.rod(bark, (0, 0, 0.6 * pot), (0.05, 0.03, height * 0.65), 0.02)
        for i in range(int(rng.integers(2, 6))):
            size = rng.uniform(0.35, 0.6) * height
            place = (
                0.18 * height * math.cos(2.4 * i),
                0.18 * height * math.sin(2.4 * i),
                rng.uniform(0.35, 0.6) * height,
            )
            frame.add(pick(rng, "leaves0", "leaves1", "fronds"), green, (size, size, 0.8 * size), place)
