"""Trees, bushes and hedges, each on the ground at the origin of its frame."""

import math

from zoedepth.synthetic.palette import Random, bark, leaves, pick
from zoedepth.synthetic.scene import Frame


def tree(frame: Frame, rng: Random, height: float, *, bare: bool = False) -> None:
    """Grow a tree of about ``height`` metres: a conifer, or a trunk and limbs with a crown, or ``bare``.

    The farther it is from the middle of the scene, the fewer parts it has.
    """
    stem, green = bark(rng), leaves(rng)
    away = math.hypot(frame.x, frame.y)
    if rng.random() < 0.16 and not bare:
        frame.add("trunk", stem, (0.05 * height, 0.05 * height, height * 0.9))
        width = height * rng.uniform(0.3, 0.5)
        for turn in (0.0, 1.0, 2.1)[: 3 if away < 30 else 2]:
            frame.add("conifer", green, (width, width, height * 0.93), (0, 0, 0.08 * height), yaw=turn)
        return
    width = height * rng.uniform(0.4, 0.75)
    fork = height * rng.uniform(0.22, 0.42)
    thick = rng.uniform(0.03, 0.055) * height
    frame.add("trunk", stem, (thick, thick, 0.8 * height), pitch=rng.normal(0, 0.03), roll=rng.normal(0, 0.03))
    count = int(rng.integers(5, 10)) if away < 60 else 4
    for i in range(count):
        turn = 2.4 * i + rng.uniform(0, 1)
        out, up = width / 2 * rng.uniform(0.3, 0.75) * (i > 0), rng.uniform(0.5, 0.85)
        place = (out * math.cos(turn), out * math.sin(turn), up * height)
        frame.rod(stem, (0, 0, fork + 0.1 * height * rng.random()), place, 0.008 * height)
        if bare:
            for _ in range(4):
                end = tuple(p + rng.uniform(-0.14, 0.14) * height for p in place)
                frame.rod(stem, place, (end[0], end[1], abs(end[2])), 0.004 * height)
            continue
        size = width * rng.uniform(0.4, 0.62)
        z = place[2] - 0.4 * size
        frame.add(
            pick(rng, "blob0", "blob1", "blob2"),
            green,
            (0.74 * size, 0.74 * size, 0.6 * size),
            (place[0], place[1], z + 0.08 * size),
            yaw=turn,
        )
        for k in range(2 if away < 16 else 1 if away < 90 else 0):
            name = pick(rng, "leaves0", "leaves1", "leaves2")
            frame.add(
                name,
                green,
                (1.1 * size, 1.1 * size, 0.95 * size),
                (place[0], place[1], z),
                yaw=turn + k,
                roll=rng.uniform(0, 3),
            )


def bush(frame: Frame, rng: Random, size: float) -> None:
    """Grow a round bush, about ``size`` metres across."""
    green = leaves(rng)
    for i in range(int(rng.integers(1, 4))):
        each, turn = size * rng.uniform(0.6, 1.0), rng.uniform(0, 6)
        at = (0.3 * size * i * math.cos(turn), 0.3 * size * i * math.sin(turn), -0.1 * each)
        frame.add(pick(rng, "blob0", "blob1"), green, (0.85 * each, 0.85 * each, 0.8 * each), at, yaw=turn)
        frame.add(pick(rng, "leaves1", "leaves2"), green, (1.1 * each, 1.1 * each, each), at, yaw=turn)


def hedge(frame: Frame, rng: Random, length: float) -> None:
    """Grow a hedge of ``length`` metres along x."""
    green, height, deep = leaves(rng), rng.uniform(0.7, 1.9), rng.uniform(0.5, 0.9)
    frame.add("soft", green, (length, deep, height))
    for i in range(int(length / 0.9)):
        frame.add(
            pick(rng, "leaves0", "leaves1"),
            green,
            (1.3, deep * 1.25, height * 0.7),
            (-length / 2 + 0.45 + 0.9 * i, 0, 0.4 * height),
            yaw=rng.choice([0, math.pi]),
        )
