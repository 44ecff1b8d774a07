"""Kitchen units, bathroom fittings, and things left on the floor."""

from collections.abc import Callable

from zoedepth.synthetic import furniture
from zoedepth.synthetic.clutter import book_pile, scatter
from zoedepth.synthetic.furniture import Style
from zoedepth.synthetic.palette import (
    Random,
    any_color,
    ceramic,
    cloth,
    hsv,
    metal,
    pick,
    picture,
    plastic,
    scaled,
    wood,
    writing,
)
from zoedepth.synthetic.scene import Frame, Material

WHITE = Material("plain", (0.86, 0.86, 0.84), gloss=0.15)
CHROME = Material("plain", (0.7, 0.7, 0.72), gloss=0.8, mirror=0.4)
Size = tuple[float, float, float]
"""(width, depth, height), metres."""


def kitchen_units(frame: Frame, rng: Random, style: Style, size: Size, ceiling: float) -> None:
    """Build a stretch of kitchen: units, worktop, tiles, perhaps a sink or a stove, and cupboards above.

    Args:
        ceiling: height of the room, metres: the hood over the stove reaches up to it.
    """
    wide, deep, high = size
    kitchen = Style(style.wood, style.wood, style.cloth, style.second_cloth, style.metal, 2)
    furniture.cabinet(frame, rng, kitchen, wide, high - 0.03, deep - 0.04, things=0)
    top = Material(
        pick(rng, "marble", "terrazzo", "wood"),
        hsv(0.09, rng.uniform(0, 0.4), rng.uniform(0.2, 0.85)),
        (0.3, 0.28, 0.25),
        0.6,
        0.3,
    )
    frame.add("box", top, (wide, deep, 0.035), (0, 0, high - 0.03))
    tile = any_color(rng, saturation=(0, 0.4), value=(0.5, 0.95))
    tiles = Material("tiles", tile, (0.8, 0.8, 0.78), rng.uniform(0.08, 0.2), 0.3)
    frame.add("box", tiles, (wide, 0.01, 0.55), (0, deep / 2, high))
    kind = rng.random()
    if kind < 0.35 and wide > 0.7:
        frame.add(
            "box",
            Material("plain", (0.04, 0.04, 0.04), gloss=0.6, mirror=0.08),
            (0.58, 0.5, 0.012),
            (0, 0, high + 0.002),
        )
        frame.add("cylinder", metal(rng), (0.22, 0.22, rng.uniform(0.1, 0.2)), (0.12, 0.1, high + 0.015))
        frame.add("taper", CHROME, (0.6, 0.5, 0.25), (0, 0.05, 1.55))
        frame.add("box", CHROME, (0.28, 0.28, max(ceiling - 1.8, 0.1)), (0, 0.12, 1.8))
    elif kind < 0.65 and wide > 0.7:
        frame.add("box", CHROME, (0.55, 0.42, 0.012), (0, -0.02, high))
        frame.add(
            "box", Material("plain", (0.25, 0.25, 0.26), gloss=0.4), (0.46, 0.34, 0.004), (0, -0.02, high + 0.011)
        )
        frame.rod(CHROME, (0, 0.2, high), (0, 0.2, high + 0.28), 0.014)
        frame.rod(CHROME, (0, 0.2, high + 0.28), (0, 0.02, high + 0.24), 0.012)
    if (kind >= 0.35 or wide <= 0.7) and rng.random() < 0.75:
        furniture.cabinet(
            frame.at(0, deep / 2 - 0.18, 1.42), rng, kitchen, wide, min(0.75, ceiling - 1.5), 0.34, things=0
        )
    scatter(frame.at(0, 0.05, high + 0.007), rng, wide, 0.45, int(rng.integers(1, 7)))


def _bath(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    wide, deep, high = size
    for x in (-1, 1):
        frame.add("box", WHITE, (0.09, deep, high), (x * (wide / 2 - 0.045), 0, 0))
    for y in (-1, 1):
        frame.add("box", WHITE, (wide, 0.07, high), (0, y * (deep / 2 - 0.035), 0))
    frame.add("box", WHITE, (wide - 0.1, deep - 0.1, 0.15))
    frame.rod(CHROME, (wide / 2 - 0.05, 0, high), (wide / 2 - 0.05, 0, high + 0.15), 0.015)


def _toilet(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    frame.add("frustum", WHITE, (0.3, 0.4, 0.36), (0, -0.08, 0))
    frame.add("bowl", WHITE, (0.4, 0.5, 0.25), (0, -0.08, 0.17))
    frame.add("soft", pick(rng, WHITE, plastic(rng), style.wood), (0.38, 0.48, 0.04), (0, -0.08, 0.41))
    frame.add("soft", WHITE, (0.42, 0.2, 0.4), (0, size[1] / 2 - 0.11, 0.4))


def _sink(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    wide, deep, high = size
    furniture.cabinet(frame, rng, style, wide, high - 0.12, deep, things=0)
    frame.add("box", WHITE, (wide, deep, 0.03), (0, 0, high - 0.12))
    frame.add(pick(rng, "bowl", "bowl", "cup"), WHITE, (0.42, 0.36, 0.13), (0, -0.03, high - 0.1))
    frame.rod(CHROME, (0, 0.18, high - 0.1), (0, 0.18, high + 0.1), 0.013)
    mirror = Material("plain", (0.05, 0.05, 0.05), mirror=0.85)
    frame.add("box", mirror, (wide * 0.9, 0.015, 0.7), (0, deep / 2, high + 0.3))
    scatter(frame.at(0.3 * wide, 0, high - 0.09), rng, 0.35 * wide, 0.3, 3)


def _fridge(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    wide, deep, high = size
    door = pick(rng, WHITE, CHROME._replace(mirror=0.15), plastic(rng))
    split = high * rng.uniform(0.3, 0.65)
    shell = door._replace(color=scaled(door.color, 0.85), mirror=0.0)
    frame.add("box", shell, (wide, deep - 0.05, high))
    frame.add("soft", door, (wide, 0.07, split - 0.01), (0, -deep / 2 + 0.03, 0.02))
    frame.add("soft", door, (wide, 0.07, high - split - 0.02), (0, -deep / 2 + 0.03, split + 0.01))
    for z in (split - 0.4, split + 0.08):
        frame.add("box", CHROME, (0.02, 0.03, 0.28), (-0.4 * wide, -deep / 2 - 0.02, max(z, 0.1)))
    scatter(frame.at(0, 0, high), rng, wide, deep - 0.1, 3)


def _boxes(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    """Pile up boxes, stack beside stack."""
    wide, deep, high = size
    card = Material("stained", hsv(0.08, 0.45, rng.uniform(0.45, 0.7)), hsv(0.08, 0.5, 0.4), 1.0)
    x = -wide / 2
    while x < wide / 2 - 0.25:
        side, z = min(rng.uniform(0.25, 0.6), wide / 2 - x), 0.0
        while z < high - 0.2:
            tall = rng.uniform(0.15, 0.45)
            material = card if rng.random() < 0.7 else pick(rng, plastic(rng), writing(rng, 0.06), wood(rng))
            box = (side - 0.02, deep * rng.uniform(0.7, 1.0), tall)
            frame.add("box", material, box, (x + side / 2, 0, z), yaw=rng.normal(0, 0.05))
            z += tall
        x += side


def _television(frame: Frame, rng: Random, style: Style, size: Size) -> None:
    """Set up a television on a low cabinet."""
    wide, deep, high = size
    furniture.cabinet(frame, rng, style, wide, high, deep, things=0)
    screen = min(wide - 0.05, rng.uniform(0.8, 1.4))
    on = rng.random() < 0.4
    off = Material("plain", (0.02, 0.02, 0.025), gloss=0.4, mirror=0.12)
    shown = picture(rng)._replace(glow=0.8, gloss=0.1) if on else off
    black = Material("plain", (0.04, 0.04, 0.04))
    frame.add("box", black, (0.4, 0.2, 0.02), (0, 0, high))
    frame.add("box", black, (screen, 0.05, 0.57 * screen), (0, 0.03, high + 0.05))
    frame.add("box", shown, (screen - 0.03, 0.006, 0.57 * screen - 0.03), (0, 0.003, high + 0.065))


FITTINGS: dict[str, Callable[[Frame, Random, Style, Size], None]] = {
    "bath": _bath, "toilet": _toilet, "sink": _sink, "fridge": _fridge, "boxes": _boxes, "tv": _television,
}  # fmt: skip
"""Name → function that builds the item, given its frame, the generator, the room's style and (width, depth, height)."""


def floor_thing(frame: Frame, rng: Random) -> None:
    """Leave something on the floor."""
    kind = int(rng.integers(7))
    size = rng.uniform(0.2, 0.45)
    if kind == 0:
        frame.add("box", Material("stained", hsv(0.08, 0.45, 0.6), hsv(0.08, 0.5, 0.4)), (size, size * 0.8, size * 0.8))
    elif kind == 1:
        frame.add("sphere", plastic(rng), (size * 0.7, size * 0.7, size * 0.7))
    elif kind == 2:
        frame.add("cup", plastic(rng), (0.26, 0.26, 0.32))
    elif kind == 3:
        frame.add("cushion", cloth(rng), (size * 1.4, size * 1.4, size * 0.8))
    elif kind == 4:
        frame.add("torso", cloth(rng), (size, size * 0.6, size * 1.3))
    elif kind == 5:
        book_pile(frame, rng, int(rng.integers(2, 9)))
    else:
        for x in (-0.07, 0.07):
            frame.add("soft", ceramic(rng), (0.1, 0.28, 0.09), (x, rng.normal(0, 0.03), 0))
