"""Things that stand and move in a street, each at the origin of its frame; vehicles and people look towards +y."""

import math
from collections.abc import Callable

from zoedepth.synthetic.palette import (
    Random,
    any_color,
    bricks,
    cloth,
    glass,
    hsv,
    metal,
    pick,
    plastic,
    scaled,
    wood,
    writing,
)
from zoedepth.synthetic.scene import Color, Frame, Material

RUBBER = Material("plain", (0.04, 0.04, 0.04))
STEEL = Material("plain", (0.45, 0.46, 0.47), gloss=0.2)
WINDOW = Material("plain", (0.05, 0.055, 0.06), gloss=0.4, mirror=0.3)


def car(frame: Frame, rng: Random) -> float:
    """Build a car of one of four makes and return its length in metres."""
    name = pick(rng, "sedan", "hatchback", "hatchback", "suv", "suv", "van")
    length, width, waist, roof = {
        "sedan": (4.6, 1.8, 0.7, 0.55), "hatchback": (4.0, 1.75, 0.72, 0.6),
        "suv": (4.6, 1.88, 0.85, 0.68), "van": (5.2, 1.98, 1.0, 1.0),
    }[name]  # fmt: skip
    length, waist, roof = (
        length * rng.uniform(0.92, 1.08),
        waist * rng.uniform(0.95, 1.08),
        roof * rng.uniform(0.92, 1.1),
    )
    value = rng.random()
    color: Color = (
        hsv(rng.random(), rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.8))
        if value > 0.65
        else hsv(0.6, rng.uniform(0, 0.12), pick(rng, 0.05, 0.15, 0.35, 0.6, 0.85, 0.92))
    )
    paint = Material("plain", color, gloss=0.6, mirror=0.07)
    at = frame.at(0, 0, 0, math.pi / 2)  # the shapes' noses are at +x
    low, radius = 0.2, rng.uniform(0.3, 0.36)
    at.add(f"{name} body", paint, (length, width, waist), (0, 0, low))
    share = {"sedan": 0.58, "hatchback": 0.68, "suv": 0.72, "van": 0.82}[name]
    back = {"sedan": -0.03, "hatchback": -0.12, "suv": -0.1, "van": -0.07}[name] * length
    top = low + waist - 0.08
    at.add(f"{name} cabin", WINDOW, (length * share, width * 0.9, roof + 0.06), (back, 0, top))
    at.add(
        "soft",
        paint,
        (length * share * 0.56, width * 0.7, 0.07),
        (back + (0.01 if name != "sedan" else -0.04) * length, 0, top + roof),
    )
    for x in (-0.17, 0.06):
        for y in (-1, 1):
            start, end = (
                (back + x * length * share / 0.7, y * width * 0.44, top),
                (back + x * length * share / 0.7, y * width * 0.35, top + roof + 0.05),
            )
            at.rod(paint, start, end, 0.035)
    lamp, tail = (
        Material("plain", (0.9, 0.9, 0.85), gloss=0.5, glow=rng.choice([0.0, 0.0, 2.0])),
        Material("plain", (0.6, 0.03, 0.03), gloss=0.4, glow=rng.choice([0.0, 0.5])),
    )
    for y in (-1, 1):
        for x in (-0.31, 0.31):
            wheel = at.at(x * length, y * (width / 2 - 0.12))
            _wheel(wheel, radius)
        at.add("soft", lamp, (0.18, 0.32, 0.14), (0.465 * length, y * width * 0.36, low + waist * 0.52))
        at.add("soft", tail, (0.14, 0.26, 0.2), (-0.475 * length, y * width * 0.38, low + waist * 0.58))
        at.add(
            "soft", paint, (0.12, 0.2, 0.14), (back + 0.25 * length * share + 0.3, y * (width / 2 + 0.06), top + 0.04)
        )
    plate = Material("text", (0.9, 0.9, 0.85), (0.05, 0.05, 0.05), 0.11)
    for x in (-1, 1):
        at.add("box", plate, (0.03, 0.5, 0.11), (x * 0.495 * length, 0, low + 0.2 * waist))
    return length


def _wheel(frame: Frame, radius: float) -> None:
    """Put up a wheel whose axis is y."""
    frame.add("cylinder", RUBBER, (2 * radius, 2 * radius, 0.22), (0, 0, radius - 0.11), roll=math.pi / 2)
    hub = Material("plain", (0.5, 0.5, 0.52), gloss=0.4)
    frame.add("cylinder", hub, (1.25 * radius, 1.25 * radius, 0.235), (0, 0, radius - 0.1175), roll=math.pi / 2)


def truck(frame: Frame, rng: Random) -> float:
    """Build a lorry or a bus and return its length in metres."""
    at = frame.at(0, 0, 0, math.pi / 2)
    paint = Material("plain", any_color(rng, saturation=(0, 0.9), value=(0.2, 0.95)), gloss=0.4, mirror=0.04)
    if rng.random() < 0.5:
        length, height = rng.uniform(8, 12), rng.uniform(2.7, 3.1)
        at.add("box", paint, (length, 2.5, height - 0.35), (0, 0, 0.35))
        at.add("box", WINDOW, (length - 0.8, 2.52, 0.95), (0, 0, 1.45))
        at.add("box", WINDOW, (length + 0.02, 2.1, 1.3), (0, 0, 1.2))
        at.add("box", Material("text", paint.color, (0.9, 0.9, 0.85), 0.4), (length * 0.6, 2.53, 0.45), (0, 0, 0.75))
        for i in range(int(length / 1.5)):
            at.add("box", RUBBER, (0.08, 2.54, 0.95), (-length / 2 + 1.2 + 1.5 * i, 0, 1.45))
    else:
        length, height = rng.uniform(6, 9), rng.uniform(2.7, 3.7)
        cargo = pick(
            rng,
            paint,
            Material("slats", (0.8, 0.8, 0.78), (0.5, 0.5, 0.5), 0.25),
            Material("text", (0.9, 0.9, 0.88), any_color(rng), 0.7),
        )
        at.add("box", cargo, (length - 2.0, 2.45, height - 0.95), (-1.0, 0, 0.95))
        at.add("box", Material("plain", (0.08, 0.08, 0.08)), (length - 0.4, 1.0, 0.35), (-0.2, 0, 0.55))
        at.add("soft", paint, (1.9, 2.35, 2.2), (length / 2 - 0.95, 0, 0.45))
        at.add("soft", WINDOW, (1.5, 2.37, 0.8), (length / 2 - 0.72, 0, 1.6))
    for x in (-0.32, 0.34):
        for y in (-1, 1):
            _wheel(at.at(x * length, y * 1.12), 0.48)
    return length


def bicycle(frame: Frame, rng: Random) -> None:
    """Park a bicycle along y."""
    paint = plastic(rng)
    for y in (-0.52, 0.52):
        frame.add("ring", RUBBER, (0.68, 0.04, 0.68), (0, y, 0), yaw=math.pi / 2)
    points = ((0, -0.52, 0.34), (0, -0.12, 0.3), (0, -0.22, 0.82), (0, 0.35, 0.85), (0, 0.52, 0.34))
    for a, b in ((0, 1), (1, 2), (2, 3), (1, 3), (3, 4), (0, 2)):
        frame.rod(paint, points[a], points[b], 0.018)
    frame.add("soft", RUBBER, (0.15, 0.27, 0.07), (0, -0.24, 0.86))
    frame.rod(STEEL, (-0.28, 0.33, 1.0), (0.28, 0.33, 1.0), 0.015)
    frame.rod(STEEL, (0, 0.35, 0.85), (0, 0.33, 1.0), 0.015)


def person(frame: Frame, rng: Random) -> None:
    """Place a grown-up or a child, standing or walking."""
    height = rng.uniform(1.5, 1.9) if rng.random() < 0.88 else rng.uniform(1.0, 1.4)
    k = height / 1.75
    skin = Material("plain", hsv(rng.uniform(0.03, 0.08), rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.9)))
    top, trousers = cloth(rng), Material("fabric", hsv(rng.random(), rng.uniform(0, 0.5), rng.uniform(0.05, 0.5)))
    stride = rng.uniform(0, 0.32) * k
    skirt = rng.random() < 0.15
    for x, step in ((-0.09, stride), (0.09, -stride)):
        hip, knee, foot = (x * k, 0, 0.86 * k), (x * k, 0.35 * step + 0.04, 0.46 * k), (x * k, step, 0.06)
        frame.rod(trousers, hip, knee, 0.075 * k, shape="cylinder")
        frame.rod(skin if skirt else trousers, knee, foot, 0.055 * k, shape="cylinder")
        frame.add("soft", RUBBER, (0.1 * k, 0.26 * k, 0.09 * k), (x * k, step + 0.05, 0))
        shoulder, elbow = (2.2 * x * k, 0, 1.4 * k), (2.6 * x * k, -0.4 * step - 0.02, 1.13 * k)
        hand = (2.4 * x * k, -0.8 * step + 0.08, 0.88 * k)
        frame.rod(top, shoulder, elbow, 0.05 * k, shape="cylinder")
        frame.rod(top if rng.random() < 0.7 else skin, elbow, hand, 0.04 * k, shape="cylinder")
        frame.add("sphere", skin, (0.09 * k, 0.09 * k, 0.11 * k), (hand[0], hand[1], hand[2] - 0.08))
    if skirt:
        frame.add("frustum", trousers, (0.5 * k, 0.4 * k, 0.5 * k), (0, 0, 0.48 * k))
    frame.add("torso", top, (0.44 * k, 0.26 * k, 0.64 * k), (0, 0, 0.83 * k))
    frame.rod(skin, (0, 0, 1.42 * k), (0, 0, 1.55 * k), 0.05 * k)
    frame.add("sphere", skin, (0.16 * k, 0.2 * k, 0.24 * k), (0, 0.01, 1.51 * k))
    hair = Material("plain", hsv(0.08, 0.5, rng.uniform(0.03, 0.5)))
    frame.add("sphere", hair, (0.18 * k, 0.21 * k, 0.2 * k), (0, -0.025, 1.575 * k))
    if rng.random() < 0.35:
        frame.add("soft", pick(rng, cloth(rng), plastic(rng)), (0.28 * k, 0.16 * k, 0.42 * k), (0, -0.2 * k, 0.98 * k))


def fence(frame: Frame, rng: Random, length: float) -> None:
    """Put up a fence along x: boards, bars, a wall or rails."""
    kind, height = int(rng.integers(4)), rng.uniform(0.8, 1.7)
    material = pick(rng, wood(rng), STEEL, metal(rng))
    if kind == 0:
        frame.add("box", bricks(rng), (length, 0.25, height * 0.8))
        frame.add("box", Material("panels", (0.6, 0.58, 0.55)), (length, 0.32, 0.07), (0, 0, height * 0.8))
        return
    for i in range(int(length / 2) + 1):
        frame.add("box", material, (0.09, 0.09, height + 0.06), (-length / 2 + 2 * i, 0, 0))
    for z in (0.2, 0.85):
        frame.add("box", material, (length, 0.04, 0.07), (0, 0, z * height))
    if kind < 3:
        step, wide = (0.14, 0.1) if kind == 1 else (0.16, 0.025)
        for i in range(int(length / step)):
            frame.add("box", material, (wide, 0.022, height), (-length / 2 + step * (i + 0.5), -0.03, 0.06))


def street_lamp(frame: Frame, rng: Random, height: float, arm: float) -> None:
    """Put up a lamp of ``height`` metres; its arm reaches ``arm`` metres to +x, or to -x if that is negative."""
    material = pick(rng, STEEL, Material("plain", (0.1, 0.11, 0.1), gloss=0.2))
    frame.rod(material, (0, 0, 0), (0, 0, height), 0.06 if height > 5 else 0.045)
    frame.add("cylinder", material, (0.22, 0.22, 0.7))
    if abs(arm) > 0.3:
        frame.rod(material, (0, 0, height - 0.1), (arm, 0, height + 0.25), 0.04)
        frame.add("soft", material, (0.7, 0.25, 0.13), (arm, 0, height + 0.17))
    else:
        frame.add(
            "shade", Material("plain", (0.85, 0.83, 0.75), gloss=0.4), (0.32, 0.32, 0.42), (0, 0, height), roll=math.pi
        )
        frame.add("dome", material, (0.4, 0.4, 0.12), (0, 0, height + 0.42))


def sign(frame: Frame, rng: Random) -> None:
    """Put up a traffic sign that is read from -y."""
    height = rng.uniform(2.0, 2.7)
    frame.rod(STEEL, (0, 0, 0), (0, 0, height + 0.3), 0.03)
    red, blue = Material("plain", (0.75, 0.06, 0.06), gloss=0.1), Material("plain", (0.06, 0.2, 0.6), gloss=0.1)
    kind, at = int(rng.integers(5)), frame.at(0, -0.05, height - 0.3)
    white = Material("text", (0.92, 0.92, 0.9), (0.05, 0.05, 0.05), 0.2)
    if kind == 0:
        at.add("cylinder", red, (0.64, 0.64, 0.015), (0, 0, 0.3), roll=math.pi / 2)
        at.add("cylinder", white, (0.48, 0.48, 0.02), (0, -0.005, 0.3), roll=math.pi / 2)
    elif kind == 1:
        at.add("gable", red, (0.72, 0.015, 0.64))
        at.add("gable", white, (0.5, 0.02, 0.44), (0, -0.005, 0.07))
    elif kind == 2:
        at.add("box", blue, (0.6, 0.015, 0.6))
        at.add("box", white, (0.35, 0.02, 0.4), (0, -0.005, 0.1))
    elif kind == 3:
        at.add("cylinder", blue, (0.6, 0.6, 0.015), (0, 0, 0.3), roll=math.pi / 2)
    else:
        board = Material(
            "text",
            pick(rng, (0.06, 0.25, 0.5), (0.9, 0.8, 0.1), (0.05, 0.35, 0.2), (0.9, 0.9, 0.9)),
            (0.95, 0.95, 0.95),
            0.18,
        )
        at.add("box", board, (rng.uniform(0.8, 1.6), 0.02, rng.uniform(0.4, 1.0)))


def traffic_light(frame: Frame, rng: Random) -> None:
    """Put up a traffic light that is seen from -y."""
    dark = Material("plain", (0.07, 0.08, 0.07))
    frame.rod(STEEL, (0, 0, 0), (0, 0, 3.3), 0.06)
    frame.add("box", dark, (0.3, 0.22, 0.9), (0, -0.1, 2.4))
    lit = int(rng.integers(3))
    for i, color in enumerate(((0.1, 0.8, 0.3), (0.9, 0.6, 0.1), (0.9, 0.1, 0.08))):
        frame.add(
            "sphere",
            Material("plain", color if i == lit else scaled(color, 0.25), glow=2.5 if i == lit else 0),
            (0.2, 0.08, 0.2),
            (0, -0.22, 2.45 + 0.28 * i),
        )


def street_thing(frame: Frame, rng: Random) -> None:
    """Put down one of the things that stand on pavements; its front is at -y."""
    put = _THINGS[int(rng.integers(len(_THINGS)))]
    put(frame, rng)


def _bench(frame: Frame, rng: Random) -> None:
    slats, iron = wood(rng), Material("plain", (0.1, 0.1, 0.1))
    for i in range(4):
        frame.add("box", slats, (1.6, 0.09, 0.035), (0, -0.2 + 0.12 * i, 0.43))
    for z in (0.6, 0.74):
        frame.add("box", slats, (1.6, 0.03, 0.1), (0, 0.26, z), roll=-0.15)
    for x in (-0.65, 0.65):
        frame.add("box", iron, (0.05, 0.45, 0.43), (x, 0, 0))


def _wheeled_bin(frame: Frame, rng: Random) -> None:
    material = plastic(rng)
    frame.add("taper", material, (0.58, 0.7, 0.95), (0, 0, 0.08), roll=math.pi)
    frame.add("box", material._replace(color=scaled(material.color, 0.8)), (0.62, 0.74, 0.08), (0, 0, 1.0))


def _litter_bin(frame: Frame, rng: Random) -> None:
    frame.add("cylinder", pick(rng, STEEL, plastic(rng)), (0.42, 0.42, 0.85))
    frame.add("dome", STEEL, (0.45, 0.45, 0.16), (0, 0, 0.85))


def _bollards(frame: Frame, rng: Random) -> None:
    for i in range(int(rng.integers(1, 5))):
        material = pick(rng, STEEL, Material("stripes", (0.8, 0.1, 0.1), (0.9, 0.9, 0.9), 0.4))
        frame.add("cylinder", material, (0.12, 0.12, 0.95), (0, 1.6 * i, 0))


def _hydrant(frame: Frame, rng: Random) -> None:
    red = Material("plain", (0.7, 0.1, 0.08))
    frame.add("cylinder", red, (0.22, 0.22, 0.6))
    frame.add("dome", red, (0.24, 0.24, 0.14), (0, 0, 0.6))


def _traffic_cone(frame: Frame, rng: Random) -> None:
    frame.add("cone", Material("stripes", (0.95, 0.35, 0.05), (0.92, 0.92, 0.9), 0.3), (0.32, 0.32, 0.7))
    frame.add("box", RUBBER, (0.4, 0.4, 0.04))


def _letter_box(frame: Frame, rng: Random) -> None:
    frame.add("box", pick(rng, STEEL, plastic(rng)), (0.8, 0.4, 1.1))
    frame.add("box", writing(rng, 0.1), (0.5, 0.42, 0.5), (0, 0, 0.4))


def _bicycles(frame: Frame, rng: Random) -> None:
    for i in range(int(rng.integers(1, 4))):
        bicycle(frame.at(0.6 * i, 0, 0, rng.normal(0, 0.1)), rng)


def _bus_shelter(frame: Frame, rng: Random) -> None:
    panes, width = glass(rng), rng.uniform(2.5, 4)
    frame.add("box", STEEL, (width, 1.5, 0.1), (0, 0, 2.35))
    frame.add("box", panes, (width, 0.03, 1.9), (0, 0.7, 0.35))
    frame.add("box", writing(rng, 0.15)._replace(glow=0.3), (0.12, 1.2, 1.8), (width / 2, 0, 0.35))
    for x in (-1, 1):
        frame.rod(STEEL, (x * width / 2, 0.7, 0), (x * width / 2, 0.7, 2.35), 0.04)
    frame.add("box", wood(rng), (width * 0.7, 0.35, 0.05), (0, 0.45, 0.45))


_THINGS: tuple[Callable[[Frame, Random], None], ...] = (
    _bench, _wheeled_bin, _litter_bin, _bollards, _hydrant, _traffic_cone, _letter_box, _bicycles, _bus_shelter,
)  # fmt: skip
