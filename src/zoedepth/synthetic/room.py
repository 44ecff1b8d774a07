"""Rooms: walls with windows and doors, and furniture along them and in the middle."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from zoedepth.synthetic import furniture
from zoedepth.synthetic.clutter import plant
from zoedepth.synthetic.fittings import FITTINGS, floor_thing, kitchen_units
from zoedepth.synthetic.furniture import Style, room_style
from zoedepth.synthetic.interior import Opening, doorway, hang_on_wall, radiator, wall_pieces, window  # fmt: skip
from zoedepth.synthetic.lamps import ceiling_lamps, floor_lamp, table_lamp
from zoedepth.synthetic.palette import Random, cloth, floor_covering, hsv, pick, wall_paint
from zoedepth.synthetic.pose import Pose
from zoedepth.synthetic.scene import Frame, Material, Scene
from zoedepth.synthetic.weather import daylight

KINDS = (
    "living", "living", "bedroom", "bedroom", "kitchen", "office", "office", "dining", "bathroom", "library", "storage",
)  # fmt: skip
"""Kinds of rooms; those named twice are twice as likely."""


@dataclass
class Room:
    """A furnished room: its floor is at z = 0, its middle at the origin. Sizes are in metres."""

    scene: Scene
    width: float
    depth: float
    height: float
    kind: str
    style: Style
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Rectangles of the floor that are in use: x0, y0, x1, y1."""

    def free(self, x: float, y: float, half_x: float, half_y: float) -> bool:
        """Return True if the rectangle around (x, y) lies in the room and on no other."""
        if abs(x) + half_x > self.width / 2 or abs(y) + half_y > self.depth / 2:
            return False
        return all(
            x + half_x < x0 or x - half_x > x1 or y + half_y < y0 or y - half_y > y1 for x0, y0, x1, y1 in self.taken
        )

    def take(self, x: float, y: float, half_x: float, half_y: float) -> None:
        """Mark the rectangle around (x, y) as in use."""
        self.taken.append((x - half_x, y - half_y, x + half_x, y + half_y))

    def draw_pose(self, rng: Random) -> Pose:
        """Draw a camera where a person could hold it, looking across the room."""
        x = y = 0.0
        for _ in range(60):
            x, y = rng.uniform(-0.5, 0.5) * (self.width - 0.5), rng.uniform(-0.5, 0.5) * (self.depth - 0.5)
            if self.free(x, y, 0.12, 0.12):
                break
        target = rng.uniform(-0.42, 0.42) * self.width - 0.25 * x, rng.uniform(-0.42, 0.42) * self.depth - 0.25 * y
        z = min(max(rng.normal(1.4, 0.3), 0.6), min(2.2, self.height - 0.3))
        away = max(math.hypot(target[0] - x, target[1] - y), 1.0)
        drop = math.atan2(rng.uniform(0.3, 1.5) - z, away)
        field_of_view = rng.normal(63, 3) if rng.random() < 0.55 else rng.uniform(45, 90)
        return Pose(
            (x, y, z),
            yaw=math.atan2(target[1] - y, target[0] - x) + rng.normal(0, 0.15),
            pitch=max(-0.7, drop) + rng.normal(0, 0.07),
            roll=rng.normal(0, 0.03 if rng.random() < 0.8 else 0.12),
            field_of_view=math.radians(field_of_view),
        )


class Wall(NamedTuple):
    """A wall of a room."""

    frame: Frame
    """On the floor, in the middle of the wall; +y is out of the room."""
    length: float
    """Metres."""
    openings: list[Opening]
    """Windows and doors from left to right."""


def build_room(rng: Random) -> Room:
    """Build a room of a kind, size and style drawn from ``rng``."""
    kind = pick(rng, *KINDS)
    longest = {"bathroom": 3.8, "kitchen": 5.5, "storage": 6.0}.get(kind, 9.0)
    width, depth = (2.5 + (longest - 2.5) * rng.beta(1.5, 2.2) for _ in range(2))
    height = rng.uniform(2.25, 2.8) if rng.random() < 0.75 else rng.uniform(2.8, 3.5)
    scene = Scene()
    room = Room(scene, width, depth, height, kind, room_style(rng))
    daylight(scene, rng)
    walls = _shell(room, rng)
    _along_walls(room, rng, walls)
    _middle(room, rng)
    for _ in range(int(rng.poisson(2.5))):
        x, y = rng.uniform(-0.5, 0.5) * width, rng.uniform(-0.5, 0.5) * depth
        if room.free(x, y, 0.25, 0.25):
            room.take(x, y, 0.2, 0.2)
            floor_thing(scene.at(x, y, 0, rng.uniform(-3, 3)), rng)
    power = ceiling_lamps(scene.at(0, 0, height), rng, width, depth, forced=not scene.sunlit)
    base = (0.04 + 0.02 * power + 0.05 * len(scene.sunlit)) * rng.uniform(0.6, 1.4)
    scene.ambient = (base, base * 0.97, base * 0.93)
    return room


def _shell(room: Room, rng: Random) -> list[Wall]:
    """Build floor, ceiling and walls with their windows and doors."""
    scene, width, depth, height = room.scene, room.width, room.depth, room.height
    paint, floor = wall_paint(rng)._replace(world=True), floor_covering(rng)
    if room.kind == "bathroom" and rng.random() < 0.7:
        color = hsv(rng.random(), rng.uniform(0, 0.3), rng.uniform(0.6, 0.95))
        paint = Material("tiles", color, (0.85, 0.85, 0.83), rng.uniform(0.12, 0.4), 0.35, 0.04, world=True)
    accent = wall_paint(rng)._replace(world=True) if rng.random() < 0.35 else paint
    ceiling = Material("plaster", hsv(0.1, rng.uniform(0, 0.08), rng.uniform(0.8, 0.95)))
    if rng.random() < 0.12:
        panels, planks = Material("panels", (0.85, 0.85, 0.83), scale=0.6), room.style.wood._replace(pattern="planks")
        ceiling = pick(rng, panels, floor_covering(rng), planks)
    outer = (width + 0.4, depth + 0.4, 0.2)
    scene.at(0, 0).add("box", floor, outer, (0, 0, -0.2))
    scene.at(0, 0).add("box", ceiling, outer, (0, 0, height))
    walls: list[Wall] = []
    window_walls = set(rng.choice(4, size=int(rng.integers(1, 3)), replace=False).tolist())
    accent_wall = int(rng.integers(4))
    skirting = pick(rng, None, Material("plain", (0.85, 0.84, 0.82)), room.style.wood)
    for side in range(4):
        length, away = (width, depth / 2) if side % 2 == 0 else (depth, width / 2)
        yaw = side * math.pi / 2
        frame = scene.at(-math.sin(yaw) * away, math.cos(yaw) * away, 0, yaw)
        has_door = any(opening.kind != "window" for wall in walls for opening in wall.openings)
        openings = _openings(rng, length, height, windows=side in window_walls, has_door=has_door)
        wall_pieces(frame, accent if side == accent_wall else paint, length, height, openings, skirting)
        for opening in openings:
            if opening.kind == "window":
                window(frame, rng, opening, height)
                if opening.bottom > 0.6 and rng.random() < 0.4:
                    radiator(frame, rng, opening)
            else:
                doorway(frame, rng, opening, room.style, floor)
                near = frame.world((opening.left + opening.right) / 2, -0.45, 0)
                room.take(near[0], near[1], 0.45, 0.45)
        walls.append(Wall(frame, length, openings))
    return walls


def _openings(rng: Random, length: float, height: float, *, windows: bool, has_door: bool) -> list[Opening]:
    """Draw the windows and doors of a wall from left to right.

    Args:
        windows: the wall may have windows.
        has_door: the room has a door already, so that another one is less likely.
    """
    openings: list[Opening] = []
    x = -length / 2 + rng.uniform(0.3, 0.9)
    while x < length / 2 - 1.0:
        if windows and rng.random() < 0.8:
            opening = Opening.window(rng, x, min(length / 2 - 0.2 - x, 2.4), height)
        elif rng.random() < (0.2 if has_door else 0.6):
            has_door = True
            opening = Opening(x, x + rng.uniform(0.78, 1.0), 0.0, 2.05, pick(rng, "door", "door", "doorway"))
        else:
            x += rng.uniform(0.5, 2.0)
            continue
        openings.append(opening)
        x = opening.right + rng.uniform(0.3, 1.5)
    return openings


_ITEMS: dict[str, tuple[str, ...]] = {
    "living": ("sofa", "sofa", "shelf", "cabinet", "tv", "armchair", "lamp", "plant", "sideboard"),
    "bedroom": ("bed", "wardrobe", "dresser", "night", "desk", "shelf", "chair", "plant", "lamp"),
    "kitchen": ("counter", "counter", "fridge", "cabinet", "shelf", "chair"),
    "office": ("desk", "desk", "desk", "shelf", "cabinet", "plant", "wardrobe"),
    "dining": ("sideboard", "cabinet", "chair", "plant", "shelf", "lamp"),
    "bathroom": ("bath", "toilet", "sink", "shelf", "dresser"),
    "library": ("shelf", "shelf", "shelf", "desk", "armchair", "lamp"),
    "storage": ("shelf", "boxes", "boxes", "wardrobe", "cabinet", "chair"),
}
"""Kind of room → items that stand along its walls; those named twice are twice as likely."""


def _along_walls(room: Room, rng: Random, walls: list[Wall]) -> None:
    """Furnish each wall from corner to corner, where doors and windows allow it, and hang things on it."""
    filling = rng.uniform(0.6, 1.0)
    for side in rng.permutation(4):
        frame, length, openings = walls[int(side)]
        x = -length / 2 + rng.uniform(0.02, 0.3)
        items = 0
        while x < length / 2 - 0.4:
            if rng.random() > filling:
                x += rng.uniform(0.4, 1.6)
                continue
            name = pick(rng, *_ITEMS[room.kind])
            wide, deep, high = _footprint(name, rng, room.height)
            wide = min(wide, length / 2 - x - 0.02)
            middle, gap = x + wide / 2, rng.uniform(0.01, 0.06)
            blocked = any(o.left < x + wide and o.right > x and (o.bottom < high) for o in openings)
            place = frame.world(middle, -deep / 2 - gap, 0)
            half = (wide / 2, deep / 2) if side % 2 == 0 else (deep / 2, wide / 2)
            small = wide < {"sofa": 1.2, "bed": 0.9, "desk": 0.9, "bath": 1.3, "counter": 0.6}.get(name, 0.35)
            if blocked or small or not room.free(place[0], place[1], half[0] - 0.005, half[1] - 0.005):
                x += rng.uniform(0.15, 0.5)
                continue
            room.take(*place[:2], *half)
            _place(frame.at(middle, -deep / 2 - gap, 0, rng.normal(0, 0.015)), rng, room, name, (wide, deep, high))
            items += 1
            x += wide + (rng.uniform(0, 0.02) if name == "counter" else rng.uniform(0.02, 0.6))
        hang_on_wall(frame, rng, length, room.height, openings, room.style)


def _footprint(name: str, rng: Random, height: float) -> tuple[float, float, float]:
    """Draw the width, depth and height in metres of an item that stands against a wall."""
    low, high = {
        "sofa": ((1.4, 0.8, 0.8), (2.6, 1.0, 0.95)), "armchair": ((0.8, 0.8, 0.8), (1.0, 0.95, 0.95)),
        "bed": ((0.95, 2.1, 0.9), (1.9, 2.1, 1.2)), "shelf": ((0.5, 0.25, 0.8), (1.9, 0.4, 2.3)),
        "cabinet": ((0.6, 0.4, 0.8), (1.6, 0.5, 2.0)), "wardrobe": ((0.8, 0.55, 1.8), (2.2, 0.65, 2.3)),
        "dresser": ((0.7, 0.42, 0.7), (1.4, 0.5, 1.2)), "sideboard": ((1.1, 0.4, 0.5), (2.0, 0.48, 0.95)),
        "night": ((0.4, 0.38, 0.4), (0.55, 0.45, 0.65)), "tv": ((1.1, 0.38, 0.35), (1.8, 0.48, 0.6)),
        "desk": ((1.0, 0.65, 0.7), (1.8, 0.8, 0.77)), "lamp": ((0.5, 0.5, 1.3), (0.5, 0.5, 1.8)),
        "plant": ((0.6, 0.6, 0.7), (0.8, 0.8, 1.9)), "chair": ((0.5, 0.6, 0.9), (0.6, 0.7, 0.9)),
        "counter": ((0.8, 0.62, 0.88), (2.6, 0.65, 0.92)), "fridge": ((0.58, 0.62, 1.2), (0.9, 0.72, 1.95)),
        "bath": ((1.5, 0.72, 0.55), (1.8, 0.8, 0.6)), "toilet": ((0.42, 0.68, 0.8), (0.45, 0.7, 0.85)),
        "sink": ((0.55, 0.48, 0.85), (1.2, 0.52, 0.88)), "boxes": ((0.5, 0.4, 0.5), (1.4, 0.7, 1.8)),
    }[name]  # fmt: skip
    wide, deep, tall = (rng.uniform(a, b) for a, b in zip(low, high, strict=True))
    return wide, deep, min(tall, height - 0.1)


def _place(frame: Frame, rng: Random, room: Room, name: str, size: tuple[float, float, float]) -> None:
    """Build the item of this name, one of ``_ITEMS``."""
    wide, deep, high = size
    style = room.style
    if name in ("sofa", "armchair"):
        furniture.sofa(frame, rng, style, wide, deep)
    elif name == "bed":
        furniture.bed(frame, rng, style, wide, deep - 0.1)
    elif name == "shelf":
        furniture.shelf(frame, rng, style, wide, high, deep)
    elif name == "desk":
        furniture.desk(frame, rng, style, wide, deep)
        chair = frame.world(0, -deep, 0)
        room.take(chair[0], chair[1], 0.3, 0.3)
    elif name == "lamp":
        floor_lamp(frame, rng)
    elif name == "plant":
        plant(frame, rng, high)
    elif name == "chair":
        furniture.chair(frame, rng, style, int(rng.integers(6)))
    elif name == "counter":
        kitchen_units(frame, rng, style, size, room.height)
    elif name in FITTINGS:
        FITTINGS[name](frame, rng, style, size)
    else:
        furniture.cabinet(frame, rng, style, wide, high, deep, things=int(rng.integers(0, 7)))
        if name == "night" and rng.random() < 0.6:
            table_lamp(frame.at(0, 0, high), rng)


def _middle(room: Room, rng: Random) -> None:
    """Put a rug and a table with chairs or a sofa in the middle, where there is room."""
    x, y = rng.uniform(-0.12, 0.12) * room.width, rng.uniform(-0.12, 0.12) * room.depth
    frame = room.scene.at(x, y, 0, pick(rng, 0, math.pi / 2) + rng.normal(0, 0.04))
    if rng.random() < 0.55 and room.kind not in ("kitchen", "storage", "bathroom"):
        size = (rng.uniform(1.2, min(3.2, room.width * 0.7)), rng.uniform(0.9, min(2.4, room.depth * 0.6)), 0.012)
        rug = pick(
            rng,
            Material("ornament", hsv(rng.random(), 0.5, 0.5), hsv(rng.random(), 0.4, 0.7), rng.uniform(0.2, 0.7)),
            cloth(rng),
            cloth(rng),
        )
        frame.add(pick(rng, "box", "box", "cylinder"), rug, size)
    wide, deep = {"dining": (1.8, 0.95), "living": (1.1, 0.6), "office": (1.8, 0.8), "library": (1.6, 0.9)}.get(
        room.kind, (0.9, 0.7)
    )
    wide, deep = wide * rng.uniform(0.75, 1.3), deep * rng.uniform(0.8, 1.2)
    if room.kind in ("bedroom", "bathroom") or not room.free(x, y, wide / 2 + 0.3, wide / 2 + 0.3):
        return
    low = room.kind == "living" and rng.random() < 0.75
    height = rng.uniform(0.35, 0.5) if low else rng.uniform(0.7, 0.78)
    furniture.table(frame, rng, room.style, wide, deep, height, things=int(rng.integers(1, 9)))
    room.take(x, y, wide / 2 + (0.1 if low else 0.45), wide / 2 + (0.1 if low else 0.45))
    if low:
        if rng.random() < 0.6 and room.free(x, y, 1.4, 1.4):
            furniture.sofa(frame.at(0, deep / 2 + 0.85), rng, room.style, rng.uniform(1.4, 2.2))
            sofa = frame.world(0, deep / 2 + 0.85, 0)
            room.take(sofa[0], sofa[1], 1.0, 1.0)
        return
    _chairs(frame, rng, room.style, wide, deep)


def _chairs(frame: Frame, rng: Random, style: Style, wide: float, deep: float) -> None:
    """Put chairs around a table of ``wide`` x ``deep`` metres; all are of one kind."""
    kind = int(rng.integers(6))
    n_long = max(1, int(wide / 0.7))
    for side in (-1, 1):
        for i in range(n_long):
            if rng.random() < 0.85:
                x = ((i + 0.5) / n_long - 0.5) * wide + rng.normal(0, 0.04)
                y = side * (deep / 2 + rng.uniform(0.0, 0.4))
                yaw = (0 if side > 0 else math.pi) + rng.normal(0, 0.25)
                furniture.chair(frame.at(x, y, 0, yaw), rng, style, kind)
        if rng.random() < 0.5:
            x, yaw = side * (wide / 2 + rng.uniform(0.05, 0.3)), -side * math.pi / 2 + rng.normal(0, 0.2)
            furniture.chair(frame.at(x, 0, 0, yaw), rng, style, kind)
