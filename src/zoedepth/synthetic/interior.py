"""Walls with their windows and doors, and the things that hang on them.

The frame of a wall is on the floor, in the middle of the wall's inner side; +y is out of the room.
"""

import math
from typing import NamedTuple

from zoedepth.synthetic import furniture
from zoedepth.synthetic.clutter import scatter, thing
from zoedepth.synthetic.fittings import CHROME, WHITE
from zoedepth.synthetic.furniture import Style
from zoedepth.synthetic.palette import (
    Random,
    cloth,
    floor_covering,
    hsv,
    metal,
    pick,
    picture,
    plastic,
    scaled_material,
    wall_paint,
    wood,
    writing,
)  # fmt: skip
from zoedepth.synthetic.scene import Frame, Light, Material

THICK = 0.2
"""Thickness of walls, metres."""


class Opening(NamedTuple):
    """A hole in a wall: metres along the wall from its middle, and metres above the floor."""

    left: float
    right: float
    bottom: float
    top: float
    kind: str
    """window, door (shut) or doorway (an open door)."""

    @classmethod
    def window(cls, rng: Random, left: float, widest: float, height: float) -> "Opening":
        """Draw a window, from a hatch to a wall of glass.

        Args:
            left: place of its left side.
            widest: largest width, metres.
            height: height of the room, metres.
        """
        bottom = pick(rng, 0.05, 0.6, 0.85, 0.9, 1.0)
        top = min(bottom + rng.uniform(1.0, 1.6) if bottom > 0.3 else 2.15, height - 0.15)
        return cls(left, left + min(rng.uniform(0.6, 2.2), widest), bottom, top, "window")


def wall_pieces(
    frame: Frame, material: Material, length: float, height: float, openings: list[Opening], skirting: Material | None
) -> None:
    """Build a wall around its openings, from left to right, with skirting boards."""

    def piece(left: float, right: float, bottom: float, top: float) -> None:
        if right - left > 1e-3 and top - bottom > 1e-3:
            frame.add("box", material, (right - left, THICK, top - bottom), ((left + right) / 2, THICK / 2, bottom))

    x = -length / 2 - THICK
    for opening in openings:
        piece(x, opening.left, 0, height)
        piece(opening.left, opening.right, 0, opening.bottom)
        piece(opening.left, opening.right, opening.top, height)
        x = opening.right
    piece(x, length / 2, 0, height)
    if skirting is not None:
        edges = [
            -length / 2,
            *(e for o in openings if o.kind != "window" for e in (o.left - 0.06, o.right + 0.06)),
            length / 2,
        ]
        for left, right in zip(edges[::2], edges[1::2], strict=True):
            frame.add("box", skirting, (max(right - left, 0.01), 0.016, 0.08), ((left + right) / 2, -0.008, 0))


def window(frame: Frame, rng: Random, opening: Opening, height: float) -> None:
    """Build a window with its sill and curtains or blinds, and the light that comes in through it.

    Args:
        height: height of the room, metres.
    """
    width, tall = opening.right - opening.left, opening.top - opening.bottom
    middle = (opening.left + opening.right) / 2
    material = WHITE if rng.random() < 0.7 else wood(rng)
    at = frame.at(middle, 0.1, opening.bottom)
    bright = rng.uniform(0.8, 3.0)
    clear = rng.random() < 0.7
    tint = (0.85 + 0.1 * rng.random(), 0.95, 1.0)
    green = hsv(rng.uniform(0.08, 0.4), rng.uniform(0.1, 0.6), rng.uniform(0.3, 0.7))
    view = Material("view", tint, green, glow=bright * 0.7, known=False)
    frosted = Material("fabric", tint, glow=0.5 * bright)
    at.add("box", view if clear else frosted, (width, 0.01, tall), (0, 0.02, 0))
    _window_bars(at, rng, material, width, tall)
    if opening.bottom > 0.3:
        frame.add("box", material, (width + 0.1, 0.26, 0.03), (middle, -0.02, opening.bottom - 0.02))
        if rng.random() < 0.5:
            scatter(frame.at(middle, -0.03, opening.bottom + 0.01), rng, width, 0.24, 3)
    power = 0.32 * bright * width * tall * _curtains(frame.at(middle, -0.1), rng, opening, height, bright)
    out, side = frame.at(0, 1).world(0, 0, 0), frame.at(1, 0).world(0, 0, 0)
    facing = (frame.x - out[0], frame.y - out[1], 0.0)
    half_u = ((side[0] - frame.x) * width / 2, (side[1] - frame.y) * width / 2, 0.0)
    centre = at.world(0, -0.06, tall / 2)
    light = Light(centre, (power * tint[0], power * tint[1], power * tint[2]), half_u, (0, 0, tall / 2), facing)
    frame.scene.lights.append(light)
    if clear:
        frame.scene.sunlit.append(light)


def _window_bars(frame: Frame, rng: Random, material: Material, width: float, tall: float) -> None:
    """Put the frame around a pane, and bars across it."""
    for x in (-1, 1):
        frame.add("box", material, (0.06, 0.07, tall), (x * (width / 2 - 0.03), 0, 0))
    for z in (0, tall - 0.06):
        frame.add("box", material, (width, 0.07, 0.06), (0, 0, z))
    for i in range(1, max(1, round(width / rng.uniform(0.5, 1.2)))):
        frame.add("box", material, (0.06, 0.06, tall), (width * (i / max(1, round(width / 0.7)) - 0.5), 0, 0))
    if rng.random() < 0.4:
        frame.add("box", material, (width, 0.05, 0.04), (0, 0, tall * rng.uniform(0.4, 0.75)))


def _curtains(frame: Frame, rng: Random, opening: Opening, height: float, bright: float) -> float:
    """Hang curtains or a blind before a window, or nothing; return the share of its light that they let in."""
    width, tall = opening.right - opening.left, opening.top - opening.bottom
    kind = rng.random()
    if kind < 0.45:
        rail = min(opening.top + 0.12, height - 0.05)
        drop = rail - (0.02 if rng.random() < 0.6 or opening.bottom < 0.3 else opening.bottom - 0.15)
        fabric = cloth(rng)
        frame.rod(metal(rng), (-width / 2 - 0.35, 0, rail), (width / 2 + 0.35, 0, rail), 0.014)
        each = rng.uniform(0.25, 0.55) if rng.random() < 0.85 else width / 2
        for x in (-1, 1):
            at = (x * (width / 2 + 0.2 - each / 2), 0, rail - drop)
            frame.add(pick(rng, "curtain", "curtain", "folds"), fabric, (each, 0.09, drop), at)
        return 0.8
    if kind < 0.65:
        drop = tall * rng.uniform(0.15, 0.95)
        color = hsv(0.1, 0.1, rng.uniform(0.6, 0.9))
        slats = Material("slats", color, (0.2, 0.2, 0.2), 0.035, glow=0.15 * bright)
        frame.add("box", slats, (width + 0.06, 0.03, drop), (0, 0.06, opening.top - drop))
        return 1 - 0.8 * drop / tall
    return 1.0


def doorway(frame: Frame, rng: Random, opening: Opening, style: Style, floor: Material) -> None:
    """Build a shut door, or an open one with a stretch of the next room."""
    width, tall = opening.right - opening.left, opening.top
    middle = (opening.left + opening.right) / 2
    material = WHITE if rng.random() < 0.5 else style.wood
    for x in (opening.left - 0.03, opening.right + 0.03):
        frame.add("box", material, (0.07, 0.24, tall + 0.035), (x, 0.09, 0))
    frame.add("box", material, (width + 0.13, 0.24, 0.07), (middle, 0.09, tall))
    leaf = material if rng.random() < 0.6 else wood(rng)
    if opening.kind == "door":
        _leaf(frame.at(middle, 0.08), rng, leaf, width, tall)
        return
    angle = rng.uniform(0.9, 1.9)
    hinge = frame.at(opening.left + 0.01, 0.2, 0, angle)
    _leaf(hinge.at(width / 2, 0), rng, leaf, width - 0.02, tall)
    _next_room(frame.at(middle, THICK), rng, width, style, floor)


def _next_room(frame: Frame, rng: Random, width: float, style: Style, floor: Material) -> None:
    """Build the stretch of the next room that an open door shows; the frame is in the door, ``width`` metres wide."""
    far, half = rng.uniform(1.3, 4.5), rng.uniform(0.7, 2.0)
    paint = wall_paint(rng)
    ground = floor if rng.random() < 0.5 else floor_covering(rng)
    frame.add("box", ground, (2 * half, far, 0.2), (0, far / 2, -0.2))
    frame.add("box", WHITE, (2 * half, far, 0.1), (0, far / 2, 2.5))
    frame.add("box", paint, (2 * half, 0.1, 2.5), (0, far, 0))
    for x in (-1, 1):
        frame.add("box", paint, (0.1, far, 2.5), (x * half, far / 2, 0))
        if half - 0.05 > width / 2:  # the back of the wall is the room's own
            frame.add("box", paint, (half - width / 2, 0.02, 2.5), (x * (half + width / 2) / 2, 0.01, 0))
    if rng.random() < 0.7:
        place = frame.at(rng.uniform(-0.2, 0.2) * half, far - 0.28)
        furniture.cabinet(place, rng, style, min(0.9, half), rng.uniform(0.7, 1.8), 0.4)
    if rng.random() < 0.7:
        power = rng.uniform(0.3, 1.5)
        centre = frame.world(0, 0.5 * far, 2.4)
        frame.scene.lights.append(Light(centre, (power, 0.9 * power, 0.75 * power), (0.1, 0, 0), (0, 0.1, 0)))


def _leaf(frame: Frame, rng: Random, material: Material, width: float, height: float) -> None:
    """Build the leaf of a door with panels and handles."""
    frame.add("box", material, (width, 0.04, height))
    for side in (-1, 1):
        for i in range(pick(rng, 0, 1, 2, 3)):
            frame.add(
                "box",
                scaled_material(material, 0.92),
                (0.62 * width, 0.006, 0.5),
                (0, side * 0.022, 0.25 + 0.6 * i),
            )
        frame.add("box", CHROME, (0.13, 0.03, 0.02), (0.36 * width, side * 0.05, 1.03))


def radiator(frame: Frame, rng: Random, opening: Opening) -> None:
    """Put a ribbed radiator below a window."""
    width, middle = min(opening.right - opening.left, 1.4), (opening.left + opening.right) / 2
    frame.add("box", WHITE, (width, 0.04, opening.bottom - 0.28), (middle, -0.06, 0.14))
    for i in range(round(width / 0.09)):
        frame.add(
            "box", WHITE, (0.05, 0.08, opening.bottom - 0.24), (middle - width / 2 + 0.045 + 0.09 * i, -0.06, 0.12)
        )


def hang_on_wall(
    frame: Frame, rng: Random, length: float, height: float, openings: list[Opening], style: Style
) -> None:
    """Hang up pictures, mirrors, small shelves and clocks where the wall has no opening."""
    x = -length / 2 + rng.uniform(0.2, 1.0)
    while x < length / 2 - 0.5:
        wide, tall = rng.uniform(0.2, 1.0), rng.uniform(0.2, 0.8)
        z = rng.uniform(1.25, 1.6)
        if (
            rng.random() < 0.6
            and x + wide < length / 2
            and not any(o.left < x + wide + 0.1 and o.right > x - 0.1 for o in openings)
        ):
            at = frame.at(x + wide / 2, 0, min(z, height - tall - 0.15))
            kind = rng.random()
            if kind < 0.65:
                edge = pick(rng, style.wood, style.metal, plastic(rng))
                at.add("box", edge, (wide, 0.03, tall), (0, -0.016, 0))
                inner = (wide - 0.05, 0.006, tall - 0.05)
                at.add("box", pick(rng, picture(rng), picture(rng), writing(rng, 0.05)), inner, (0, -0.032, 0.025))
            elif kind < 0.75:
                at.add("box", Material("plain", (0.05, 0.05, 0.05), mirror=0.85), (wide, 0.02, tall), (0, -0.012, 0))
            elif kind < 0.92:
                at.add("box", style.wood, (wide, 0.2, 0.025), (0, -0.1, 0))
                for i in (-1, 0, 1):
                    thing(at.at(i * wide / 3.5, -0.1, 0.025, rng.uniform(-0.5, 0.5)), rng, 0.07)
            else:
                at.add("cylinder", plastic(rng), (0.3, 0.3, 0.04), (0, -0.02, 0), roll=math.pi / 2)
                at.add(
                    "cylinder",
                    Material("text", (0.9, 0.9, 0.9), (0.05, 0.05, 0.05), 0.06),
                    (0.26, 0.26, 0.045),
                    (0, -0.022, 0),
                    roll=math.pi / 2,
                )
        x += wide + rng.uniform(0.3, 2.2)
