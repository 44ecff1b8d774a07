"""Streets: a road that bends and climbs, with vehicles, buildings, trees and people along it."""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from zoedepth.synthetic.building import block, house
from zoedepth.synthetic.greenery import bush, hedge, tree
from zoedepth.synthetic.palette import Random, hsv, pick, scaled
from zoedepth.synthetic.pose import Pose
from zoedepth.synthetic.scene import Frame, Material, Scene
from zoedepth.synthetic.traffic import car, fence, person, sign, street_lamp, street_thing, traffic_light, truck
from zoedepth.synthetic.weather import weather

KINDS = ("city", "city", "town", "suburb", "suburb", "avenue", "country", "industry")
"""Kinds of streets; those named twice are twice as likely."""
BEHIND, AHEAD, STEP = -24.0, 200.0, 6.0
"""Where the road starts and ends, in metres along it from the camera's start, and the length of its pieces."""


@dataclass
class Street:
    """A road and the things along it; the camera stands near place 0 of the road."""

    scene: Scene
    path: np.ndarray
    """Rows of x, y, z (metres) and heading (radians), one every ``STEP`` metres from ``BEHIND`` on."""
    half: float
    """Half the width of the carriageway, metres."""
    pavement: float
    """Width of the pavements, metres."""
    kind: str
    parked: list[tuple[float, float]]
    """(place along the road, offset to the right) of the vehicles, metres."""

    def at(self, along: float, right: float, yaw: float = 0.0) -> Frame:
        """Return a place on the road or beside it, on its pavement where it has one; +y goes along the road.

        Args:
            along: place along the road, metres.
            right: offset to the right of the road's middle, metres.
            yaw: turn to the left, radians.
        """
        place = min(max((along - BEHIND) / STEP, 0), len(self.path) - 1.001)
        i, t = int(place), place % 1.0
        x, y, z, heading = self.path[i] * (1 - t) + self.path[i + 1] * t
        raised = 0.13 if self.pavement and abs(right) > self.half else 0.0
        frame = self.scene.at(float(x), float(y), float(z), float(heading) - math.pi / 2)
        return frame.at(right, 0, raised, yaw)

    def draw_pose(self, rng: Random) -> Pose:
        """Draw a camera, mostly in a car, else on a pavement."""
        if rng.random() < 0.7:
            along, right = rng.uniform(-6, 12), self.half * rng.uniform(0.1, 0.6) * pick(rng, 1, 1, -1)
            height, turn = rng.uniform(1.2, 1.85), rng.normal(0, 0.06 if rng.random() < 0.75 else 0.45)
        else:
            along, side = rng.uniform(-8, 14), pick(rng, -1, 1)
            right = side * (self.half + rng.uniform(0.3, max(self.pavement, 0.8)))
            height, turn = rng.uniform(1.4, 1.8), side * rng.uniform(-0.2, 1.3)
        frame = self.at(along, right)
        return Pose(
            frame.world(0, 0, height),
            yaw=frame.yaw + math.pi / 2 + turn,
            pitch=rng.normal(-0.01, 0.05),
            roll=rng.normal(0, 0.02),
            field_of_view=math.radians(rng.uniform(50, 90)),
        )


def build_street(rng: Random) -> Street:
    """Build a street of a kind, width and shape drawn from ``rng``."""
    kind = pick(rng, *KINDS)
    half = {"city": 5.0, "town": 3.6, "suburb": 3.2, "avenue": 6.0, "country": 3.3, "industry": 4.5}[
        kind
    ] * rng.uniform(0.8, 1.35)
    pavement = 0.0 if kind == "country" else rng.uniform(1.3, 4.0)
    street = Street(Scene(near=2.0), _path(rng), half, pavement, kind, [])
    weather(street.scene, rng)
    crossing = rng.uniform(14, 60) if rng.random() < 0.4 and kind != "country" else None
    _ground(street, rng, crossing)
    _vehicles(street, rng, crossing)
    for side in (-1, 1):
        _buildings(street, rng, side, crossing)
        _trees(street, rng, side, crossing)
        _pavement(street, rng, side, crossing)
    _distance(street, rng)
    return street


def _path(rng: Random) -> np.ndarray:
    """Draw a road with gentle bends and slopes; see ``Street.path``."""
    along = np.arange(BEHIND, AHEAD + STEP, STEP)
    bend = rng.normal(0, 0.004) if rng.random() < 0.6 else 0.0
    wave = rng.normal(0, 0.02) if rng.random() < 0.6 else 0.0
    heading = math.pi / 2 + bend * along + wave * np.sin(along / rng.uniform(15, 50))
    grade = np.tan(rng.normal(0, 0.03) + rng.normal(0, 0.02) * np.sin(along / rng.uniform(25, 80)))
    steps = np.stack([np.cos(heading), np.sin(heading), grade], 1) * STEP
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(steps[:-1], 0)])
    place -= place[np.abs(along).argmin()]
    return np.concatenate([place, heading[:, None]], 1)


class _Grounds(NamedTuple):
    """The materials of the ground."""

    asphalt: Material
    paving: Material
    beside: Material
    """Beyond the pavements."""
    stone: Material
    """Kerbs."""
    white: Material
    """Markings."""


def _draw_grounds(street: Street, rng: Random) -> _Grounds:
    """Draw the materials of the ground."""
    gray = rng.uniform(0.25, 0.5)
    worn = scaled((gray, gray, gray), rng.uniform(0.7, 1.2))
    asphalt = Material("asphalt", (gray, gray, gray * 1.02), worn, gloss=rng.choice([0.0, 0.0, 0.12]), world=True)
    green = hsv(rng.uniform(0.14, 0.3), rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.55))
    grass = Material("grass", green, hsv(rng.uniform(0.1, 0.25), 0.4, 0.5), world=True)
    paving = pick(
        rng,
        Material("tiles", (0.55, 0.54, 0.52), (0.4, 0.4, 0.38), rng.uniform(0.3, 0.8)),
        Material("panels", (0.55, 0.53, 0.5), scale=1.2),
        asphalt,
        Material("bricks", (0.5, 0.35, 0.3), (0.4, 0.38, 0.35), 1.5),
    )
    paving = paving._replace(world=True)
    beside = {"city": paving, "town": pick(rng, paving, grass), "industry": asphalt}.get(street.kind, grass)
    stone = Material("panels", (0.6, 0.6, 0.58), scale=1.0)
    return _Grounds(asphalt, paving, beside, stone, Material("stained", (0.85, 0.85, 0.82), (0.6, 0.6, 0.58), 0.3))


def _ground(street: Street, rng: Random, crossing: float | None) -> None:
    """Lay the carriageway with its markings, the kerbs, the pavements and the ground beside them."""
    asphalt, paving, beside, stone, white = _draw_grounds(street, rng)
    center = pick(rng, "dashes", "dashes", "line", "none") if street.half > 2.8 else "none"
    edges = rng.random() < 0.4
    half, pavement = street.half, street.pavement
    cross_half = rng.uniform(3, 5)
    for i in range(len(street.path) - 1):
        along = BEHIND + (i + 0.5) * STEP
        (x0, y0, z0, _), (x1, y1, z1, _) = street.path[i], street.path[i + 1]
        flat, rise = math.hypot(x1 - x0, y1 - y0), z1 - z0
        length, roll = math.hypot(flat, rise) + 0.25, math.atan2(rise, flat)
        frame = street.scene.at((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2, math.atan2(y1 - y0, x1 - x0) - math.pi / 2)

        slab = partial(_slab, frame, length, roll)
        if crossing is not None and abs(along - crossing) < cross_half + 1:
            slab(asphalt, -140, 140, 0.0)
            continue
        slab(asphalt, -half, half, 0.0)
        for side in (-1, 1):
            edge = side * (half + pavement)
            slab(beside, side * half if not pavement else edge, side * 160, 0.1 if pavement else -0.04)
            if pavement:
                slab(paving, side * half, edge, 0.13)
                slab(stone, side * (half - 0.15), side * (half + 0.01), 0.14)
            if edges:
                slab(white, side * (half - 0.45), side * (half - 0.33), 0.008, 0.02)
        if center == "line" or (center == "dashes" and i % 2):
            size = length if center == "line" else 3.2
            _slab(frame, size, roll, white, -0.07, 0.07, 0.008, 0.02)
        if crossing is not None and abs(along - (crossing - cross_half - 4)) <= STEP / 2:
            for k in range(int(half / 0.5)):
                _slab(frame, 3.0, roll, white, k + 0.3 - half, k + 0.8 - half, 0.01, 0.02)
    for _ in range(int(rng.integers(0, 5))):
        iron = Material("dots", (0.15, 0.15, 0.15), (0.22, 0.22, 0.22), 0.06)
        place = street.at(rng.uniform(4, 30), rng.uniform(-0.7, 0.7) * half)
        place.add("cylinder", iron, (0.65, 0.65, 0.02), (0, 0, -0.01))


def _slab(
    frame: Frame,
    length: float,
    roll: float,
    material: Material,
    one: float,
    other: float,
    top: float,
    thick: float = 0.5,
) -> None:
    """Lay a stretch of ground between two offsets to the right, in either order."""
    frame.add("box", material, (abs(other - one), length, thick), ((one + other) / 2, 0, top - thick), roll=roll)


def _clear(along: float, reach: float, crossing: float | None) -> bool:
    """Return True if a stretch of ``reach`` metres both ways keeps off the crossing."""
    return crossing is None or abs(along - crossing) > reach + 6.5


def _vehicles(street: Street, rng: Random, crossing: float | None) -> None:
    """Park cars at the kerbs and send others along the road."""
    dense = rng.uniform(0.0, 0.9) if street.kind != "country" else 0.0
    for side in (-1, 1):
        along = BEHIND + 8
        while along < 110 and street.half > 3.4:
            along += rng.uniform(5.2, 7)
            if rng.random() < dense and _clear(along, 4, crossing) and not -7 < along < 4:
                right = side * (street.half - 1.05) + rng.normal(0, 0.06)
                car(street.at(along, right, (math.pi if side < 0 else 0) + rng.normal(0, 0.02)), rng)
                street.parked.append((along, right))
    for _ in range(int(rng.poisson(3.0))):
        along = rng.uniform(8, 30) if rng.random() < 0.4 else rng.uniform(20, 130)
        side = pick(rng, -1, 1)
        right = side * street.half * (0.33 if street.half > 3.4 else 0.5)
        if all(abs(along - a) > 11 or abs(right - r) > 1.7 for a, r in street.parked):
            make = truck if rng.random() < 0.16 else car
            make(street.at(along, right, math.pi if side < 0 else 0), rng)
            street.parked.append((along, right))


def _buildings(street: Street, rng: Random, side: int, crossing: float | None) -> None:
    """Build up a side of the road, in a row or with gardens between; the country has a house at most."""
    kind = street.kind
    if kind == "country" or (kind == "avenue" and rng.random() < 0.5):
        if rng.random() < 0.5:
            place = street.at(rng.uniform(30, 90), side * (street.half + rng.uniform(8, 30)), -side * math.pi / 2)
            house(place, rng, 11, 9)
        return
    along = BEHIND + rng.uniform(0, 8)
    tall = int(rng.integers(2, 9)) if kind == "city" else int(rng.integers(2, 5))
    garden = {"city": 0.2, "town": 0.3, "suburb": 5.0, "avenue": 3.0, "industry": 6.0}[kind]
    back = street.half + street.pavement + garden * rng.uniform(0.6, 1.6)
    widths = {"suburb": (8, 12), "industry": (15, 40)}.get(kind, (7, 22))
    while along < 150:
        width = rng.uniform(*widths)
        gap = rng.uniform(2, 9) if kind in ("suburb", "industry") else rng.choice([0.0, 0.0, rng.uniform(1, 6)])
        middle = along + width / 2
        if _clear(middle, width / 2, crossing):
            frame = street.at(middle, side * (back + rng.uniform(0, 0.6)), -side * math.pi / 2)
            frame = frame.at(0, 0, -0.3)  # so that no gap shows where the ground slopes
            if kind == "suburb":
                house(frame, rng, width, rng.uniform(7, 10))
            else:
                floors = max(1, tall + int(rng.integers(-1, 2))) if kind != "industry" else int(rng.integers(1, 4))
                block(frame, rng, width, rng.uniform(9, 14), floors, near=middle < 60)
        along += width + gap


def _trees(street: Street, rng: Random, side: int, crossing: float | None) -> None:
    """Plant trees in a row along the pavement, and trees and bushes in gardens or woods."""
    kind = street.kind
    height, bare = rng.uniform(4, 13), rng.random() < 0.1
    if kind == "avenue" or (rng.random() < 0.4 and street.pavement > 1.6):
        step, along = rng.uniform(7, 14), rng.uniform(-14, -6)
        while along < 110:
            if _clear(along, 1, crossing):
                right = side * (street.half + min(street.pavement - 0.5, 0.9))
                tree(street.at(along, right, rng.uniform(0, 6)), rng, height * rng.uniform(0.85, 1.15), bare=bare)
            along += step * rng.uniform(0.9, 1.1)
    count = {"suburb": 9, "country": 22, "avenue": 10, "industry": 3, "town": 3}.get(kind, 0)
    nearest = street.half + street.pavement + (1.5 if kind != "town" else 12)
    for _ in range(int(rng.poisson(count * rng.uniform(0.4, 1.3)))):
        along, right = rng.uniform(-15, 130), side * (nearest + rng.exponential(9))
        if _clear(along, 2, crossing):
            frame = street.at(along, right, rng.uniform(0, 6))
            if rng.random() < 0.3:
                bush(frame, rng, rng.uniform(0.7, 2.2))
            else:
                tree(frame, rng, rng.uniform(3, 15), bare=bare and rng.random() < 0.5)


def _pavement(street: Street, rng: Random, side: int, crossing: float | None) -> None:
    """Line a side of the road: lamps and signs; people, things and fences on pavements, else perhaps a guard rail."""
    edge = side * (street.half + 0.4)
    _lamps(street, rng, side, edge, crossing)
    if crossing is not None:
        traffic_light(street.at(crossing - 8.5, edge), rng)
    for _ in range(int(rng.poisson(1.8))):
        sign(street.at(rng.uniform(3, 60), edge + side * 0.1, rng.normal(0, 0.1)), rng)
    if street.pavement:
        _people_and_things(street, rng, side)
        if street.kind in ("suburb", "industry"):
            _boundary(street, rng, side, crossing)
    elif rng.random() < 0.4:
        _guard_rail(street, edge + side * 0.3)


def _lamps(street: Street, rng: Random, side: int, edge: float, crossing: float | None) -> None:
    """Put up a row of lamps ``edge`` metres to the right, or of poles with wires."""
    lamp = (pick(rng, 4.0, 7.5, 8.5), pick(rng, 0.0, 1.5))
    step, along = rng.uniform(18, 32), rng.uniform(-10, 15)
    poles = rng.random() < 0.3
    while along < 130:
        if _clear(along, 0, crossing):
            street_lamp(street.at(along, edge), rng, lamp[0] if not poles else 7.5, -side * lamp[1])
            if poles:
                for z in (6.6, 7.2):
                    start, end = street.at(along, edge).world(0, 0, z), street.at(along + step, edge).world(0, 0, z)
                    street.scene.at(0, 0).rod(Material("plain", (0.05, 0.05, 0.05)), start, end, 0.02)
        along += step


def _guard_rail(street: Street, right: float) -> None:
    """Put up a rail on posts, ``right`` metres to the right of the road's middle."""
    rail, ground = Material("plain", (0.6, 0.61, 0.62), gloss=0.3), street.scene.at(0, 0)
    for i in range(30):
        at, then = street.at(-20 + 4 * i, right), street.at(-16 + 4 * i, right)
        at.add("box", Material("plain", (0.5, 0.5, 0.5)), (0.1, 0.1, 0.66))
        for z in (0.45, 0.55):
            ground.rod(rail, at.world(0, 0, z), then.world(0, 0, z), 0.06)


def _people_and_things(street: Street, rng: Random, side: int) -> None:
    """Populate a pavement; now and then somebody crosses the road."""
    for _ in range(int(rng.poisson({"city": 9, "town": 6, "avenue": 5}.get(street.kind, 2)))):
        along = rng.uniform(2, 25) if rng.random() < 0.5 else rng.uniform(5, 70)
        yaw = pick(rng, 0, math.pi) + rng.normal(0, 0.5)
        person(street.at(along, side * (street.half + rng.uniform(0.2, 1.0) * street.pavement), yaw), rng)
    if rng.random() < 0.25:
        person(street.at(rng.uniform(7, 30), rng.uniform(-1, 1) * street.half, rng.uniform(0, 6)), rng)
    right = side * (street.half + street.pavement) - side * 0.35
    for _ in range(int(rng.poisson(3.5))):
        street_thing(street.at(rng.uniform(1, 45), right, -side * math.pi / 2), rng)


def _boundary(street: Street, rng: Random, side: int, crossing: float | None) -> None:
    """Fence the gardens off, with gaps and parked cars between."""
    outer = side * (street.half + street.pavement)
    along = -12.0
    boundary = pick(rng, fence, fence, hedge)
    while along < 90:
        length = rng.uniform(6, 12)
        if rng.random() < 0.65 and _clear(along + length / 2, length / 2, crossing):
            boundary(street.at(along + length / 2, outer + side * 0.6, -side * math.pi / 2), rng, length)
        elif rng.random() < 0.5:
            car(street.at(along + length / 2, outer + side * 3.2, math.pi / 2 * pick(rng, -1, 1)), rng)
        along += length + rng.uniform(0, 0.5) + 2.5 * (rng.random() < 0.3)


def _distance(street: Street, rng: Random) -> None:
    """Close the view at the road's end with woods, blocks and hills."""
    kind = rng.random()
    for i in range(int(rng.integers(6, 22))):
        right = rng.normal(0, 60)
        frame = street.at(AHEAD - 1, right).at(0, rng.uniform(5, 60), -1)
        if kind < 0.4 or street.kind == "country":
            size = rng.uniform(8, 22)
            frame.add(
                pick(rng, "blob0", "blob1", "blob2"),
                Material("foliage", hsv(rng.uniform(0.2, 0.33), 0.4, 0.35), (0.2, 0.25, 0.12), 3),
                (size * 1.4, size, size),
                (0, 0, -2),
                yaw=i,
            )
        elif kind < 0.8:
            block(frame, rng, rng.uniform(12, 30), 12, int(rng.integers(2, 12)), near=False)
    if rng.random() < 0.4:
        for _ in range(int(rng.integers(1, 4))):
            far = rng.uniform(300, 700)
            frame = street.at(AHEAD - 1, rng.normal(0, 250)).at(0, far, -15)
            frame.add(
                "blob0",
                Material("grass", hsv(rng.uniform(0.2, 0.35), 0.35, 0.35), (0.3, 0.35, 0.25)),
                (far * 1.2, far * 0.5, rng.uniform(40, 120)),
                (0, 0, -30),
            )
