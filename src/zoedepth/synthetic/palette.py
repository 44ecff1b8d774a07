"""Materials drawn at random: woods, cloths, paints, metals and what grows."""

import colorsys
from typing import TypeVar

import numpy as np

from zoedepth.synthetic.scene import Color, Material

Random = np.random.Generator
T = TypeVar("T")


def hsv(hue: float, saturation: float, value: float) -> Color:
    """Return the sRGB colour of a hue, saturation and value, each from 0 to 1; the hue goes round."""
    return colorsys.hsv_to_rgb(hue % 1.0, min(max(saturation, 0.0), 1.0), min(max(value, 0.0), 1.0))


def scaled(color: Color, factor: float) -> Color:
    """Make a colour darker or brighter."""
    red, green, blue = color
    return min(1.0, red * factor), min(1.0, green * factor), min(1.0, blue * factor)


def mixed(one: Color, other: Color) -> Color:
    """Mix two colours, half and half."""
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2, (one[2] + other[2]) / 2


def scaled_material(material: Material, factor: float) -> Material:
    """Make both colours of a material darker or brighter."""
    return material._replace(color=scaled(material.color, factor), second=scaled(material.second, factor))


def pick(rng: Random, *choices: T) -> T:
    """Draw one of the choices."""
    return choices[int(rng.integers(len(choices)))]


def any_color(
    rng: Random, *, saturation: tuple[float, float] = (0.1, 0.8), value: tuple[float, float] = (0.15, 0.9)
) -> Color:
    """Draw a colour of any hue."""
    return hsv(rng.random(), rng.uniform(*saturation), rng.uniform(*value))


def wood(rng: Random) -> Material:
    """Draw a wood, from birch to ebony; sometimes it is painted."""
    if rng.random() < 0.22:
        white = rng.uniform(0.75, 0.95)
        return Material("plain", (white, white, white * rng.uniform(0.9, 1)), gloss=rng.uniform(0.05, 0.3))
    value = rng.uniform(0.2, 0.8)
    color = hsv(rng.uniform(0.04, 0.11), rng.uniform(0.35, 0.7), value)
    return Material(
        "wood", color, scaled(color, rng.uniform(0.5, 0.8)), rng.uniform(0.5, 1.5), rng.uniform(0.02, 0.35), grain=True
    )


def cloth(rng: Random) -> Material:
    """Draw a cloth, plain or patterned."""
    color = any_color(rng, saturation=(0.02, 0.65), value=(0.12, 0.92))
    other = any_color(rng, saturation=(0.0, 0.6), value=(0.2, 0.95))
    kind = rng.random()
    if kind < 0.6:
        return Material("fabric", color, scale=rng.uniform(0.7, 2))
    pattern = pick(rng, "stripes", "plaid", "dots", "checks", "ornament")
    return Material(pattern, color, other, rng.uniform(0.05, 0.25))


def leather(rng: Random) -> Material:
    """Draw a leather: dark, with a sheen."""
    return Material(
        "stained",
        hsv(rng.uniform(0, 0.1), rng.uniform(0.1, 0.7), rng.uniform(0.08, 0.5)),
        (0.15, 0.1, 0.08),
        0.4,
        rng.uniform(0.1, 0.3),
    )


def metal(rng: Random) -> Material:
    """Draw a metal: steel, brass or black."""
    color = pick(rng, (0.6, 0.6, 0.62), (0.35, 0.35, 0.37), (0.1, 0.1, 0.1), (0.62, 0.5, 0.25), (0.8, 0.8, 0.82))
    return Material("plain", color, gloss=rng.uniform(0.2, 0.6), mirror=rng.uniform(0.05, 0.3))


def plastic(rng: Random) -> Material:
    """Draw a plastic of any colour."""
    return Material("plain", any_color(rng, saturation=(0.0, 0.9), value=(0.1, 0.95)), gloss=rng.uniform(0.05, 0.4))


def ceramic(rng: Random) -> Material:
    """Draw glazed ceramics, often white."""
    color = hsv(rng.random(), rng.uniform(0, 0.15), rng.uniform(0.75, 0.95)) if rng.random() < 0.5 else any_color(rng)
    pattern = pick(rng, "plain", "plain", "stained", "stripes", "dots")
    return Material(pattern, color, any_color(rng), rng.uniform(0.03, 0.12), rng.uniform(0.2, 0.6))


def glass(rng: Random) -> Material:
    """Draw a glass: dark and mirroring, so that nothing behind it is seen."""
    value = rng.uniform(0.03, 0.15)
    return Material("plain", (value, value * 1.05, value * 1.1), gloss=0.5, mirror=rng.uniform(0.15, 0.4))


def wall_paint(rng: Random) -> Material:
    """Draw the paint, paper or bricks of a wall, mostly near white."""
    kind = rng.random()
    if kind < 0.6:
        color = hsv(rng.uniform(0.02, 0.2), rng.uniform(0, 0.2), rng.uniform(0.7, 0.95))
    else:
        color = any_color(rng, saturation=(0.08, 0.5), value=(0.4, 0.9))
    if kind > 0.88:
        other = scaled(color, rng.uniform(0.6, 1.3))
        return Material(pick(rng, "wallpaper", "stripes", "wallpaper"), color, other, rng.uniform(0.12, 0.5))
    if kind < 0.04:
        return bricks(rng)
    return Material("plaster", color)


def bricks(rng: Random) -> Material:
    """Draw bricks: red, yellow or painted."""
    color = pick(
        rng,
        hsv(0.03, 0.6, rng.uniform(0.35, 0.65)),
        hsv(0.09, 0.4, rng.uniform(0.5, 0.8)),
        (0.8, 0.79, 0.76),
        (0.4, 0.36, 0.34),
    )
    return Material("bricks", color, pick(rng, (0.7, 0.68, 0.64), (0.5, 0.48, 0.45)), rng.uniform(0.8, 1.4))


def floor_covering(rng: Random) -> Material:
    """Draw a floor: planks, tiles, carpet or stone."""
    kind = rng.random()
    if kind < 0.5:
        base = hsv(rng.uniform(0.05, 0.1), rng.uniform(0.3, 0.65), rng.uniform(0.3, 0.8))
        return Material(
            "planks", base, scaled(base, 0.7), rng.uniform(0.6, 1.6), rng.uniform(0, 0.35), rng.uniform(0, 0.06)
        )
    if kind < 0.72:
        base = hsv(rng.uniform(0, 0.15), rng.uniform(0, 0.35), rng.uniform(0.3, 0.9))
        if rng.random() < 0.25:
            return Material("checks", base, scaled(base, rng.uniform(0.3, 0.8)), rng.uniform(0.4, 0.9), 0.3, 0.04)
        return Material(
            "tiles",
            base,
            scaled(base, rng.uniform(0.4, 0.9)),
            rng.uniform(0.2, 0.6),
            rng.uniform(0.1, 0.4),
            rng.uniform(0, 0.1),
        )
    if kind < 0.92:
        base = any_color(rng, saturation=(0.02, 0.4), value=(0.25, 0.7))
        return Material("carpet", base, scaled(base, rng.uniform(0.6, 1.2)))
    base = hsv(0.1, rng.uniform(0, 0.15), rng.uniform(0.4, 0.85))
    return Material(pick(rng, "marble", "terrazzo"), base, scaled(base, 0.6), 1.0, 0.3, rng.uniform(0, 0.1))


def leaves(rng: Random) -> Material:
    """Draw the foliage of a plant, mostly green."""
    hue = rng.uniform(0.19, 0.36) if rng.random() < 0.88 else rng.uniform(0.03, 0.17)
    color = hsv(hue, rng.uniform(0.3, 0.75), rng.uniform(0.25, 0.6))
    return Material("foliage", color, scaled(hsv(hue - 0.04, 0.5, 0.55), rng.uniform(0.7, 1.2)), rng.uniform(0.5, 1.2))


def bark(rng: Random) -> Material:
    """Draw a bark, grey to brown."""
    color = hsv(rng.uniform(0.04, 0.12), rng.uniform(0.1, 0.45), rng.uniform(0.2, 0.5))
    return Material("bark", color, scaled(color, 0.45))


def picture(rng: Random) -> Material:
    """Draw a painting."""
    return Material("picture", any_color(rng, value=(0.4, 1)), any_color(rng, value=(0.1, 0.9)))


def writing(rng: Random, size: float) -> Material:
    """Draw print on paper, or light print on dark; ``size`` is the height of a line, metres."""
    paper, ink = any_color(rng, saturation=(0, 0.5), value=(0.7, 1)), any_color(rng, value=(0.02, 0.4))
    return Material("text", *((paper, ink) if rng.random() < 0.7 else (ink, paper)), scale=size)
