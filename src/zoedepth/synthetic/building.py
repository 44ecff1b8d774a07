"""Houses and blocks. The frame of a building is on the ground, in the middle of its front; the street is at -y."""

from zoedepth.synthetic.palette import Random, any_color, bricks, glass, hsv, metal, pick, scaled, wood
from zoedepth.synthetic.scene import Color, Frame, Material
from zoedepth.synthetic.traffic import WINDOW

WHITE = Material("plain", (0.85, 0.85, 0.82))
QUARTER = 1.5707963
"""A quarter turn, radians."""


def _wall_color(rng: Random) -> Color:
    """Draw the colour of a wall."""
    kind = rng.random()
    if kind < 0.3:
        return hsv(rng.uniform(0.01, 0.06), rng.uniform(0.35, 0.6), rng.uniform(0.3, 0.65))  # brick
    if kind < 0.85:
        return hsv(rng.uniform(0.04, 0.16), rng.uniform(0.02, 0.4), rng.uniform(0.5, 0.95))  # stone, plaster
    return any_color(rng, saturation=(0.05, 0.5), value=(0.3, 0.9))


def block(frame: Frame, rng: Random, width: float, depth: float, floors: int, *, near: bool) -> None:
    """Build a town house or an office, with a flat or a pitched roof.

    Args:
        near: add ledges, balconies, doors and shops, which only show from close by.
    """
    storey = rng.uniform(2.8, 3.5)
    height = floors * storey + rng.uniform(0.1, 0.5)
    color, trim = _wall_color(rng), hsv(0.1, rng.uniform(0, 0.2), pick(rng, 0.12, 0.5, 0.85, 0.92))
    wall = Material("facade", color, trim, storey)
    if rng.random() < 0.12 and floors > 3:
        wall = wall._replace(color=(0.12, 0.14, 0.16), gloss=0.3, mirror=0.25)  # a curtain wall of glass
    frame.add("box", wall, (width, depth, height), (0, depth / 2, 0))
    if rng.random() < 0.45 and floors < 7:
        _pitched_roof(frame, rng, width, depth, height, Material("plaster", color), dormers=near)
    else:
        frame.add("box", Material("panels", trim), (width + 0.3, 0.35, 0.45), (0, 0, height - 0.05))
        for _ in range(int(rng.integers(0, 3))):
            material = metal(rng)
            size = (rng.uniform(1, 3), 2, rng.uniform(0.8, 2.2))
            frame.add("box", material, size, (rng.uniform(-0.3, 0.3) * width, depth / 2, height))
    if near:
        _front(frame, rng, width, height, floors, storey, color, trim)


def _roof_tiles(rng: Random, *colors: Color) -> Material:
    return Material("shingles", pick(rng, *colors), (0.2, 0.18, 0.17), rng.uniform(0.8, 2))


def _pitched_roof(
    frame: Frame, rng: Random, width: float, depth: float, height: float, wall: Material, *, dormers: bool
) -> None:
    """Put a pitched roof with chimneys on a block of this ``height``; dormers only fit above the front."""
    roof = _roof_tiles(rng, (0.45, 0.2, 0.14), (0.25, 0.24, 0.25), (0.35, 0.27, 0.2))
    rise = rng.uniform(2, 4.5)
    along = rng.random() < 0.75
    at = frame.at(0, depth / 2, height, QUARTER if along else 0)
    size = (depth + 0.8, width, rise) if along else (width + 0.6, depth + 0.2, rise)
    at.add(pick(rng, "gable", "gable", "hip"), roof, size)
    for _ in range(int(rng.integers(0, 3))):
        material = bricks(rng)
        place = (rng.uniform(-0.4, 0.4) * width, depth * rng.uniform(0.35, 0.65), height)
        frame.add("box", material, (0.7, 0.6, rise + 0.6), place)
    if dormers and along:
        for i in range(int(rng.integers(0, 3))):
            dormer = frame.at((i - 1) * width / 3.3, 1.7, height + 0.3)
            dormer.add("box", wall, (1.4, 2.4, 1.3))
            dormer.add("box", WINDOW, (0.9, 0.05, 0.9), (0, -1.2, 0.2))
            dormer.add("gable", roof, (1.8, 2.8, 0.7), (0, 0, 1.3))


def _front(
    frame: Frame, rng: Random, width: float, height: float, floors: int, storey: float, color: Color, trim: Color
) -> None:
    """Give a block its plinth, ledges, shop or doors, balconies and downpipes."""
    if rng.random() < 0.7:
        plinth = (width + 0.02, 0.12, rng.uniform(0.4, 0.9))
        frame.add("box", Material("panels", scaled(color, 0.6)), plinth, (0, -0.01, 0))
    if rng.random() < 0.5:
        for i in range(1, floors):
            frame.add("box", Material("plain", trim), (width, 0.14, 0.14), (0, -0.04, i * storey - 0.07))
    if rng.random() < 0.55:
        shop(frame, rng, width, storey)
    else:
        for i in range(int(rng.integers(1, 3))):
            x = (i - 0.5) * width * 0.4
            frame.add("box", Material("plain", trim), (1.4, 0.16, 2.5), (x, -0.04, 0))
            door = pick(rng, wood(rng), Material("plain", any_color(rng), gloss=0.2), WINDOW)
            frame.add("box", door, (1.0, 0.2, 2.2), (x, -0.05, 0.1))
            frame.add("box", Material("panels", (0.5, 0.5, 0.48)), (1.6, 0.6, 0.14), (x, -0.3, 0))
    if rng.random() < 0.4 and floors > 2:
        _balconies(frame, rng, width, floors, storey, Material("plaster", color))
    for side in (-1, 1):
        if rng.random() < 0.5:
            frame.rod(metal(rng), (side * (width / 2 - 0.2), -0.08, 0), (side * (width / 2 - 0.2), -0.08, height), 0.05)


def _balconies(frame: Frame, rng: Random, width: float, floors: int, storey: float, wall: Material) -> None:
    """Put columns of balconies on all floors but the ground floor."""
    n_columns, rail = max(1, int(width / rng.uniform(3.5, 6))), pick(rng, metal(rng), glass(rng), wall)
    for column in range(n_columns):
        x = ((column + 0.5) / n_columns - 0.5) * width
        for floor in range(1, floors):
            at = frame.at(x, -0.6, floor * storey - 0.1)
            at.add("box", Material("panels", (0.6, 0.6, 0.58)), (2.4, 1.2, 0.16))
            at.add("box", rail, (2.4, 0.05, 1.0), (0, -0.57, 0.16))
            for side in (-1, 1):
                at.add("box", rail, (0.05, 1.15, 1.0), (side * 1.17, 0, 0.16))


def shop(frame: Frame, rng: Random, width: float, storey: float) -> None:
    """Put a shop into the ground floor: show windows, doors, a name, an awning."""
    frame_color = Material("plain", any_color(rng, value=(0.1, 0.8)))
    frame.add("box", frame_color, (width * 0.96, 0.2, storey * 0.82), (0, -0.02, 0))
    n = max(1, round(width * 0.96 / rng.uniform(2.2, 3.5)))
    each = width * 0.96 / n
    for i in range(n):
        x = ((i + 0.5) / n - 0.5) * width * 0.96
        door = rng.random() < 0.3
        low = 0.08 if door else rng.uniform(0.2, 0.6)
        inside = pick(rng, WINDOW, WINDOW, Material("picture", any_color(rng), any_color(rng), mirror=0.12, gloss=0.4))
        frame.add("box", inside, (each - 0.25, 0.22, storey * 0.7 - low), (x, -0.03, low))
    board = Material(
        "text",
        any_color(rng, value=(0.05, 0.9)),
        any_color(rng, saturation=(0, 0.4), value=(0.7, 1)),
        rng.uniform(0.3, 0.5),
    )
    frame.add("box", board, (width * 0.9, 0.12, 0.55), (0, -0.14, storey * 0.8))
    if rng.random() < 0.5:
        awning = Material("stripes", any_color(rng), (0.9, 0.9, 0.88), rng.uniform(0.3, 0.7))
        frame.add("box", awning, (width * 0.8, 1.4, 0.06), (0, -0.75, storey * 0.74), roll=0.35)
    if rng.random() < 0.4:
        frame.add("box", board, (0.1, 0.9, 0.7), (width * 0.35, -0.55, storey + 0.2))


def house(frame: Frame, rng: Random, width: float, depth: float) -> None:
    """Build a house: one or two storeys, a pitched roof, windows, a door and perhaps a porch or a garage."""
    storey, floors = rng.uniform(2.6, 3.0), int(rng.integers(1, 3))
    height, color = storey * floors, _wall_color(rng)
    wall = (
        bricks(rng)
        if rng.random() < 0.35
        else Material(pick(rng, "plaster", "slats", "plaster"), color, scaled(color, 0.6), 0.18)
    )
    roof = _roof_tiles(rng, (0.5, 0.22, 0.15), (0.22, 0.22, 0.23), (0.38, 0.28, 0.2))
    frame.add("box", wall, (width, depth, height), (0, depth / 2, 0))
    rise = rng.uniform(0.25, 0.5) * depth
    if rng.random() < 0.6:
        frame.at(0, depth / 2, height, QUARTER).add(pick(rng, "gable", "hip"), roof, (depth + 1.0, width + 0.8, rise))
        frame.add("gable", wall, (depth, width, rise * 0.93), (0, depth / 2, height - 0.02), yaw=QUARTER)
    else:
        rise = rng.uniform(0.3, 0.5) * width
        frame.add("gable", roof, (width + 1.0, depth + 0.8, rise), (0, depth / 2, height))
        frame.add("gable", wall, (width - 0.3, depth + 0.84, rise * 0.9), (0, depth / 2, height))
    frame.add("box", bricks(rng), (0.6, 0.6, rise + 0.9), (rng.uniform(-0.3, 0.3) * width, depth * 0.6, height))
    trim = WHITE if rng.random() < 0.7 else wood(rng)
    bays = max(2, int(width / 3))
    door = int(rng.integers(bays))
    for floor in range(floors):
        for i in range(bays):
            x = ((i + 0.5) / bays - 0.5) * width
            if floor == 0 and i == door:
                frame.add("box", trim, (1.2, 0.14, 2.25), (x, -0.02, 0))
                leaf = pick(rng, wood(rng), Material("plain", any_color(rng), gloss=0.2))
                frame.add("box", leaf, (0.95, 0.18, 2.1), (x, -0.03, 0.05))
                if rng.random() < 0.5:
                    frame.add("box", roof, (2.2, 1.4, 0.12), (x, -0.7, 2.4), roll=0.15)
                    for side in (-0.95, 0.95):
                        frame.rod(trim, (x + side, -1.3, 0), (x + side, -1.3, 2.4), 0.06)
            else:
                _window(frame, rng, trim, x, floor * storey + 0.9)
    if rng.random() < 0.4:
        at = frame.at(width / 2 + 1.6, 1.0)
        at.add("box", wall, (3.2, 6, 2.5), (0, 3, 0))
        at.add("box", Material("slats", (0.8, 0.8, 0.78), (0.5, 0.5, 0.5), 0.5), (2.5, 0.08, 2.1), (0, -0.01, 0))
        at.add("box", roof, (3.6, 6.4, 0.2), (0, 3, 2.5))


def _window(frame: Frame, rng: Random, trim: Material, x: float, z: float) -> None:
    """Put in a window that stands out of the wall a little, its lower side at height ``z``."""
    wide, tall = rng.uniform(0.9, 1.6), rng.uniform(1.0, 1.4)
    frame.add("box", trim, (wide + 0.16, 0.1, tall + 0.16), (x, -0.01, z - 0.08))
    frame.add("box", WINDOW, (wide, 0.13, tall), (x, -0.01, z))
    frame.add("box", trim, (0.05, 0.16, tall), (x, -0.01, z))
    frame.add("box", trim, (wide + 0.3, 0.26, 0.06), (x, -0.08, z - 0.12))
    if rng.random() < 0.3:
        shutter = Material("slats", any_color(rng, value=(0.15, 0.6)), (0.1, 0.1, 0.1), 0.06)
        for side in (-1, 1):
            frame.add("box", shutter, (0.45, 0.06, tall), (x + side * (wide / 2 + 0.32), -0.06, z))
