"""Lamps, on or off. One that is on adds a light to the scene."""

import math

from zoedepth.synthetic.palette import Random, ceramic, metal, pick, wood
from zoedepth.synthetic.scene import Frame, Light, Material


def table_lamp(frame: Frame, rng: Random) -> None:
    """Stand a small lamp on a table; its shade glows if it is on."""
    height, shade = rng.uniform(0.3, 0.55), rng.uniform(0.2, 0.36)
    frame.add(
        pick(rng, "vase", "leg", "jar", "cone"),
        pick(rng, ceramic(rng), metal(rng), wood(rng)),
        (0.14, 0.14, height * 0.65),
    )
    frame.add("rod", metal(rng), (0.015, 0.015, 0.5 * height), (0, 0, 0.3 * height))
    _shade(frame.at(0, 0, 0.62 * height), rng, shade, 0.7 * shade, 0.5)


def floor_lamp(frame: Frame, rng: Random) -> None:
    """Stand a lamp on the floor, 1.3 to 1.8 m tall up to its shade."""
    height = rng.uniform(1.3, 1.8)
    frame.add("cylinder", metal(rng), (0.28, 0.28, 0.02))
    frame.add("rod", metal(rng), (0.025, 0.025, height), (0, 0, 0.01))
    _shade(frame.at(0, 0, height - 0.1), rng, rng.uniform(0.3, 0.48), rng.uniform(0.2, 0.34), 0.5)


def _shade(frame: Frame, rng: Random, width: float, height: float, share_on: float) -> None:
    """Put a shade on a lamp, which is on with the probability ``share_on``."""
    on = rng.random() < share_on
    color = (1.0, rng.uniform(0.75, 0.95), rng.uniform(0.5, 0.85))
    frame.add(
        pick(rng, "shade", "dome", "cylinder"),
        Material("fabric", color, glow=rng.uniform(1, 2.5) if on else 0),
        (width, width, height),
    )
    if on:
        power = rng.uniform(0.15, 0.6)
        light = (power, power * color[1], power * color[2])
        place = frame.world(0, 0, 0.5 * height)
        frame.scene.lights.append(Light(place, light, (0.5 * width, 0, 0), (0, 0.5 * width, 0)))


def ceiling_lamps(frame: Frame, rng: Random, width: float, depth: float, *, forced: bool) -> float:
    """Hang one lamp, or rows of them, from the ceiling and return their power: 0 if they are off.

    Args:
        frame: the middle of the ceiling.
        width, depth: size of the room along x and y, metres.
        forced: the lamps are on, as there is no other light.
    """
    on = forced or rng.random() < 0.55
    warm = rng.random()
    color = (1.0, 0.8 + 0.18 * warm, 0.55 + 0.4 * warm)
    power = rng.uniform(1.0, 2.6) * math.sqrt(width * depth / 12) if on else 0.0
    kind = int(rng.integers(5))
    places = [(0.0, 0.0)]
    if kind >= 3 or width * depth > 24:
        columns, rows = max(1, round(width / 2.4)), max(1, round(depth / 2.4))
        places = [((i + 0.5) / columns - 0.5, (j + 0.5) / rows - 0.5) for i in range(columns) for j in range(rows)]
    glow = Material("plain", color, glow=rng.uniform(2, 4) if on else 0.0)
    drop = rng.uniform(0.35, 0.9)
    for x, y in places:
        at = frame.at(x * width, y * depth)
        z = -0.06
        if kind == 0:
            size = rng.uniform(0.3, 0.55)
            at.rod(metal(rng), (0, 0, -drop), (0, 0, 0), 0.006)
            at.add(pick(rng, "shade", "dome", "sphere"), glow, (size, size, 0.55 * size), (0, 0, -drop - 0.3 * size))
            z = -drop - 0.45 * size
        elif kind == 1:
            size = rng.uniform(0.3, 0.5)
            at.add("dome", glow, (size, size, 0.12), (0, 0, -0.12), roll=math.pi)
            z = -0.16
        elif kind == 2:
            for i in range(5):
                end = (0.35 * math.cos(1.257 * i), 0.35 * math.sin(1.257 * i), -drop)
                at.rod(metal(rng), (0, 0, -drop + 0.15), end, 0.01)
                at.add("sphere", glow, (0.09, 0.09, 0.11), end)
            at.rod(metal(rng), (0, 0, -drop + 0.1), (0, 0, 0), 0.012)
            z = -drop - 0.03
        elif kind == 3:
            at.add("box", glow, (1.2, 0.3, 0.05), (0, 0, -0.05))
        else:
            at.add("cylinder", glow, (0.12, 0.12, 0.03), (0, 0, -0.03))
        if on:
            each = power / len(places)
            light = (each * color[0], each * color[1], each * color[2])
            wide = 0.5 if kind == 3 else 0.12
            frame.scene.lights.append(
                Light(at.world(0, 0, z - 0.03), light, (wide, 0, 0), (0, 0.12, 0), (0, 0, -1.0) if kind >= 3 else None)
            )
    return power
