"""Furniture. Each piece stands at the origin of its frame, in the middle of its footprint, its back towards +y.

Widths, depths and heights are in metres.
"""

import math
from dataclasses import dataclass

from zoedepth.synthetic.clutter import computer, scatter, shelf_content, thing
from zoedepth.synthetic.lamps import table_lamp
from zoedepth.synthetic.palette import Random, cloth, glass, leather, metal, pick, plastic, scaled_material, wood
from zoedepth.synthetic.scene import Frame, Material


@dataclass(frozen=True)
class Style:
    """The materials that the furniture of one room shares."""

    wood: Material
    second_wood: Material
    cloth: Material
    second_cloth: Material
    metal: Material
    handles: int
    """Handles of doors and drawers: 0 for none, 1 for knobs, 2 for bars."""


def room_style(rng: Random) -> Style:
    """Draw a style."""
    seat = leather(rng) if rng.random() < 0.25 else cloth(rng)
    return Style(wood(rng), wood(rng), seat, cloth(rng), metal(rng), int(rng.integers(3)))


def table(frame: Frame, rng: Random, style: Style, width: float, depth: float, height: float, *, things: int) -> None:
    """Build a table on four legs, or a round one on one foot, with up to ``things`` small things on it."""
    top = pick(rng, style.wood, style.wood, style.second_wood, glass(rng))
    leg = pick(rng, style.wood, style.metal, style.second_wood)
    thick = rng.uniform(0.02, 0.05)
    kind = rng.random()
    if kind < 0.25 and width < 1.6:
        side = (width + depth) / 2
        frame.add("cylinder", top, (side, side, thick), (0, 0, height - thick))
        frame.add(pick(rng, "leg", "cylinder"), leg, (0.12, 0.12, height - thick))
        frame.add("frustum", leg, (0.5 * side, 0.5 * side, 0.05))
    else:
        frame.add("box", top, (width, depth, thick), (0, 0, height - thick))
        round_leg = rng.random() < 0.4
        side, inset = rng.uniform(0.03, 0.09), rng.uniform(0.03, 0.1)
        for x in (-1, 1):
            for y in (-1, 1):
                at = (x * (width / 2 - inset), y * (depth / 2 - inset), 0)
                frame.add(pick(rng, "leg") if round_leg else "box", leg, (side, side, height - thick), at)
        if rng.random() < 0.6:
            frame.add("box", leg, (width - 0.2, depth - 0.15, 0.08), (0, 0, height - thick - 0.08))
        if rng.random() < 0.25:
            frame.add("box", leg, (width - 0.15, depth - 0.15, 0.02), (0, 0, 0.18))
        if rng.random() < 0.15:
            frame.add(
                "box", style.second_cloth, (width + 0.02, depth + 0.02, thick + 0.15), (0, 0, height - thick - 0.146)
            )
    scatter(frame.at(0, 0, height + 0.004), rng, 0.9 * width, 0.85 * depth, things)


def chair(frame: Frame, rng: Random, style: Style, kind: int) -> None:
    """Build a chair: kind 0 is wooden, 1 padded, 2 with arms, 3 on castors, 4 a shell, 5 a stool."""
    seat, width = rng.uniform(0.43, 0.48), rng.uniform(0.42, 0.5)
    material, pad = pick(rng, style.wood, style.metal), pick(rng, style.cloth, style.second_cloth)
    if kind == 3:
        _swivel_chair(frame, style.metal, pad, seat)
        return
    _chair_legs(frame, material, width, seat, back=0.0 if kind in (4, 5) else 0.45)
    if kind == 5:
        frame.add("cylinder", pick(rng, material, pad), (width, width, 0.05), (0, 0, seat))
        return
    if kind == 4:
        frame.add("bowl", plastic(rng), (width + 0.05, width + 0.05, 0.12), (0, 0, seat - 0.02))
        shell = plastic(rng) if rng.random() < 0.2 else pad
        frame.add("soft", shell, (width, 0.05, 0.42), (0, width / 2 - 0.02, seat + 0.05), roll=-0.15)
        return
    if kind == 0:
        frame.add("box", material, (width, width, 0.03), (0, 0, seat - 0.01))
        for i in range(int(rng.integers(2, 5))):
            at = (0, width / 2 + 0.05, seat + 0.12 + 0.11 * i)
            frame.add("box", material, (width - 0.04, 0.02, 0.05), at, roll=-0.17)
    else:
        frame.add("soft", pad, (width, width, 0.07), (0, 0, seat - 0.01))
        frame.add("soft", pad, (width - 0.02, 0.07, 0.4), (0, width / 2 + 0.03, seat + 0.08), roll=-0.17)
    if kind == 2:
        for x in (-width / 2, width / 2):
            frame.add("soft", material, (0.05, width, 0.04), (x, 0, seat + 0.2))
            frame.rod(material, (x, -width / 2 + 0.05, 0), (x, -width / 2 + 0.05, seat + 0.21), 0.018)


def _chair_legs(frame: Frame, material: Material, width: float, seat: float, *, back: float) -> None:
    """Put up four legs; the rear ones go on to the back, which rises ``back`` metres above the seat."""
    for x in (-1, 1):
        start = (x * (width / 2 - 0.02), -width / 2 + 0.03, 0)
        frame.rod(material, start, (x * (width / 2 - 0.03), -width / 2 + 0.04, seat), 0.018)
        start = (x * (width / 2 - 0.02), width / 2, 0)
        end = (x * (width / 2 - 0.02), width / 2 + (0.08 if back else -0.03), seat + back)
        frame.rod(material, start, end, 0.018)


def _swivel_chair(frame: Frame, material: Material, pad: Material, seat: float) -> None:
    """Build an office chair on five castors."""
    frame.add("cylinder", material, (0.06, 0.06, seat - 0.1), (0, 0, 0.06))
    for i in range(5):
        x, y = 0.3 * math.cos(1.257 * i), 0.3 * math.sin(1.257 * i)
        frame.rod(material, (0, 0, 0.1), (x, y, 0.06), 0.02)
        frame.add("sphere", Material("plain", (0.05, 0.05, 0.05)), (0.05, 0.05, 0.05), (x, y, 0))
    frame.add("soft", pad, (0.5, 0.48, 0.09), (0, 0, seat - 0.04))
    frame.add("soft", pad, (0.46, 0.08, 0.58), (0, 0.24, seat + 0.08), roll=-0.12)
    for x in (-0.27, 0.27):
        frame.add("box", material, (0.03, 0.04, 0.22), (x, 0.05, seat))
        frame.add("soft", material, (0.06, 0.28, 0.035), (x, 0, seat + 0.2))


def sofa(frame: Frame, rng: Random, style: Style, width: float, depth: float = 0.9) -> None:
    """Build a sofa or, if it is narrow, an armchair."""
    low, seat, back, arm = (
        rng.uniform(0.05, 0.15),
        rng.uniform(0.38, 0.46),
        rng.uniform(0.7, 0.95),
        rng.uniform(0.1, 0.22),
    )
    frame.add("box", style.cloth, (width, depth - 0.05, seat - 0.14 - low), (0, 0, low))
    for x in (-1, 1):
        for y in (-1, 1):
            frame.add(
                "frustum",
                style.wood,
                (0.06, 0.06, low),
                (x * (width / 2 - 0.08), y * (depth / 2 - 0.1), 0),
                roll=math.pi,
            )
        frame.add("soft", style.cloth, (arm, depth, rng.uniform(0.55, 0.65) - low), (x * (width - arm) / 2, 0, low))
    frame.add("soft", style.cloth, (width, 0.24, back - low), (0, depth / 2 - 0.12, low))
    n_seats = max(1, round((width - 2 * arm) / 0.7))
    each = (width - 2 * arm) / n_seats
    for i in range(n_seats):
        x = -width / 2 + arm + each * (i + 0.5)
        frame.add("soft", style.cloth, (each - 0.01, depth - 0.22, 0.16), (x, -0.1, seat - 0.15))
        frame.add("soft", style.cloth, (each - 0.02, 0.18, 0.42), (x, depth / 2 - 0.27, seat), roll=-0.15)
    for _ in range(int(rng.integers(0, 4))):
        x, pillow = rng.uniform(-0.4, 0.4) * (width - 2 * arm), rng.uniform(0.36, 0.5)
        frame.add(
            "cushion",
            pick(rng, style.second_cloth, cloth(rng)),
            (pillow, 0.16, pillow),
            (x, depth / 2 - 0.45, seat),
            yaw=rng.normal(0, 0.3),
            roll=-0.35,
        )
    if rng.random() < 0.25:
        frame.add("soft", cloth(rng), (0.5, depth * 0.9, 0.03), (rng.uniform(-0.3, 0.3) * width, -0.08, seat + 0.005))


def bed(frame: Frame, rng: Random, style: Style, width: float, length: float = 2.05) -> None:
    """Build a bed with its head at +y."""
    low, mattress = rng.uniform(0.15, 0.32), rng.uniform(0.18, 0.28)
    frame.add("box", style.wood, (width, length, 0.12), (0, 0, low - 0.1))
    for x in (-1, 1):
        for y in (-1, 1):
            frame.add("box", style.wood, (0.08, 0.08, low), (x * (width / 2 - 0.06), y * (length / 2 - 0.06), 0))
    head = rng.uniform(0.75, 1.25)
    shape, material = pick(rng, "box", "soft"), pick(rng, style.wood, style.cloth)
    frame.add(shape, material, (width + 0.06, 0.09, head), (0, length / 2 + 0.03, 0))
    frame.add("soft", Material("fabric", (0.88, 0.87, 0.84)), (width - 0.04, length - 0.06, mattress), (0, 0, low))
    top = low + mattress
    cover, share = (
        pick(rng, style.second_cloth, cloth(rng), Material("fabric", (0.85, 0.84, 0.8))),
        rng.uniform(0.6, 0.8),
    )
    frame.add(
        "soft",
        cover,
        (width + 0.05, length * share, 0.14 + mattress * 0.6),
        (0, -length * (1 - share) / 2 - 0.02, top - mattress * 0.6 - 0.04),
    )
    if rng.random() < 0.7:
        frame.add(
            "soft", scaled_material(cover, 0.85), (width + 0.06, 0.35, 0.16), (0, length * (share - 0.62), top - 0.03)
        )
    if rng.random() < 0.4:
        frame.add(
            "soft", cloth(rng), (width + 0.08, 0.5, 0.15 + 0.4 * mattress), (0, -length / 2 + 0.4, top - 0.4 * mattress)
        )
    n_pillows = 1 if width < 1.2 else 2
    for row in range(int(rng.integers(1, 3))):
        for i in range(n_pillows):
            x = (i - (n_pillows - 1) / 2) * width / 2
            material = Material("fabric", (0.9, 0.9, 0.88)) if row == 0 else pick(rng, style.cloth, style.second_cloth)
            frame.add(
                "cushion",
                material,
                (0.62, 0.18 if row else 0.42, 0.38 if row else 0.16),
                (x, length / 2 - 0.28 - 0.22 * row, top),
                yaw=rng.normal(0, 0.08),
                roll=0.25 if not row else -0.3,
            )


def shelf(frame: Frame, rng: Random, style: Style, width: float, height: float, depth: float = 0.32) -> None:
    """Build an open shelf with books and small things."""
    thick, n_rows, n_columns = (
        0.022,
        max(1, round(height / rng.uniform(0.28, 0.42))),
        max(1, round(width / rng.uniform(0.5, 0.9))),
    )
    material, back = style.wood, rng.random() < 0.7
    if back:
        frame.add("box", scaled_material(material, 0.85), (width, 0.012, height), (0, depth / 2 - 0.006, 0))
    each, tall = width / n_columns, (height - 0.06) / n_rows
    for i in range(n_columns + 1):
        frame.add("box", material, (thick, depth, height), (-width / 2 + i * each, 0, 0))
    for row in range(n_rows + 1):
        frame.add("box", material, (width, depth - 0.01, thick), (0, 0, 0.04 + row * tall))
        if row < n_rows:
            for i in range(n_columns):
                inner = frame.at(-width / 2 + (i + 0.5) * each, depth / 2 - 0.02, 0.04 + row * tall + thick)
                shelf_content(inner, rng, each - 0.05, tall - 0.04, depth - 0.03)
    if height < 1.9:
        scatter(frame.at(0, 0, height + 0.02), rng, width, depth, int(rng.integers(0, 5)))


def cabinet(
    frame: Frame, rng: Random, style: Style, width: float, height: float, depth: float, *, things: int = 3
) -> None:
    """Build a cabinet with doors or drawers, from a night table to a wardrobe; ``things`` stand on low ones."""
    material, front = pick(rng, style.wood, style.wood, style.second_wood), pick(rng, style.wood, style.second_wood)
    foot = pick(rng, 0.0, 0.06, 0.15) if height < 1.5 else 0.05
    frame.add("box", material, (width, depth, height - foot), (0, 0, foot))
    if foot > 0.1:
        for x in (-1, 1):
            for y in (-1, 1):
                frame.add("rod", style.metal, (0.04, 0.04, foot), (x * (width / 2 - 0.05), y * (depth / 2 - 0.05), 0))
    elif foot:
        frame.add("box", scaled_material(material, 0.5), (width - 0.04, depth - 0.06, foot))
    n_columns = max(1, round(width / rng.uniform(0.4, 0.65)))
    drawers = height < 1.3 and rng.random() < 0.55
    n_rows = (
        max(1, round((height - foot) / rng.uniform(0.18, 0.3)))
        if drawers
        else (2 if height > 1.9 and rng.random() < 0.3 else 1)
    )
    each, tall = width / n_columns, (height - foot) / n_rows
    mirrored = height > 1.6 and rng.random() < 0.12
    looking_glass = Material("plain", (0.1, 0.1, 0.1), mirror=0.8)
    for i in range(n_columns):
        for row in range(n_rows):
            x, z = -width / 2 + (i + 0.5) * each, foot + row * tall
            size = (each - 0.008, 0.02, tall - 0.008)
            frame.add("box", looking_glass if mirrored else front, size, (x, -depth / 2 - 0.008, z + 0.004))
            if not drawers and rng.random() < 0.3:
                size, at = (0.7 * each, 0.006, 0.8 * tall), (x, -depth / 2 - 0.02, z + 0.1 * tall)
                frame.add("box", scaled_material(front, 0.9), size, at)
            if style.handles:
                hx = x if drawers else x + (0.5 - i % 2) * (each - 0.12)
                hz = z + (0.5 if drawers or height > 1.2 else 0.8) * tall
                bar = (0.14, 0.02, 0.015) if drawers else (0.015, 0.02, 0.16)
                shape, size = ("sphere", (0.03, 0.03, 0.03)) if style.handles == 1 else ("box", bar)
                frame.add(shape, style.metal, size, (hx, -depth / 2 - 0.03, hz))
    if height < 1.5:
        scatter(frame.at(0, 0, height), rng, 0.95 * width, 0.9 * depth, things)


def desk(frame: Frame, rng: Random, style: Style, width: float, depth: float = 0.7) -> None:
    """Build a desk with a computer on it and mostly a chair before it, at -y."""
    height = rng.uniform(0.7, 0.77)
    frame.add("box", style.wood, (width, depth, 0.03), (0, 0, height - 0.03))
    left = rng.random() < 0.6
    if left:
        cabinet(frame.at(-width / 2 + 0.22, 0.02), rng, style, 0.4, height - 0.031, depth - 0.08, things=0)
    for x in (-1, 1)[left:]:
        frame.add(
            "box",
            pick(rng, style.wood, style.metal),
            (0.04, depth - 0.04, height - 0.03),
            (x * (width / 2 - 0.03), 0, 0),
        )
    computer(frame.at(rng.uniform(-0.12, 0.12) * width, 0.05, height, rng.normal(0, 0.1)), rng)
    for x in (-0.36, 0.38):
        if rng.random() < 0.8:
            thing(frame.at(x * width, rng.uniform(-0.1, 0.2) * depth, height, rng.uniform(-0.5, 0.5)), rng, 0.1)
    if rng.random() < 0.5:
        table_lamp(frame.at(-0.42 * width, 0.25 * depth, height), rng)
    if rng.random() < 0.9:
        chair(
            frame.at(rng.normal(0, 0.1), -depth / 2 - rng.uniform(0.0, 0.35), 0, math.pi + rng.normal(0, 0.5)),
            rng,
            style,
            pick(rng, 3, 3, 0, 1, 4),
        )
