"""Patterns: functions that give the colour of many points of a surface at once."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from zoedepth.synthetic.noise import noise

Column = Float32[np.ndarray, " n"]
Colors = Float32[np.ndarray, "n 3"]


@dataclass
class Surface:
    """Points on parts that share a pattern."""

    u: Column
    """Metres from the middle of the part along the face."""
    v: Column
    """Metres along the other side of the face; up on upright faces."""
    pixel: Column
    """Size of a pixel on the surface, metres: finer detail must be averaged."""
    half_u: Column
    """Half the size of the face along u, metres."""
    half_v: Column
    """Half the size of the face along v, metres."""
    scale: Column
    """Size of the pattern; see ``Material.scale``."""
    random: Column
    """A number in [0, 1), the same on the whole part."""
    color: Colors
    """The material's colour, linear."""
    second: Colors
    """The material's other colour, linear."""
    mirror: Column
    """Share of mirrored light; a pattern may change it."""

    def noise(self, name: str, repeat: float | Column, *, stretch: float = 1.0) -> Column:
        """Return noise around 0.5 that repeats after ``repeat`` metres and starts elsewhere on each part.

        Args:
            stretch: how many times longer the noise is along u than along v.
        """
        shift = self.random * 7.31
        u, v = self.u / (repeat * stretch) + shift, self.v / repeat + 3.7 * shift
        return noise(name)(u, v, self.pixel / repeat)

    def mix(self, share: Column) -> Colors:
        """Mix the colour (share 0) with the second (share 1)."""
        return self.color + (self.second - self.color) * share[:, None]


def pattern_albedo(pattern: str, surface: Surface) -> Colors:
    """Return the linear colour of each point, clipped to [0.003, 0.95]: no surface reflects less or more."""
    return np.clip(_PATTERNS[pattern](surface), 0.003, 0.95)


def fractional(*values: Column) -> Column:
    """Hash each row of up to four numbers into one in [0, 1); equal rows get equal numbers."""
    total = np.zeros(len(values[0]), np.uint32)
    for value, prime in zip(values, (374761393, 668265263, 2147483647, 2654435761), strict=False):
        total += (value * 4096).astype(np.int64).astype(np.uint32) * np.uint32(prime)
        total = (total ^ (total >> np.uint32(13))) * np.uint32(1274126177)
    return ((total ^ (total >> np.uint32(16))) & np.uint32(0xFFFFFF)).astype(np.float32) / np.float32(0x1000000)


def _line(x: Column, period: Column | float, width: Column | float, pixel: Column) -> Column:
    """Return the share of each pixel that lines of ``width`` cover; they lie at the multiples of ``period``."""
    distance = np.abs(x - np.round(x / period) * period)
    sharp = np.clip((width / 2 - distance) / pixel + 0.5, 0, 1)
    blur = np.clip(pixel / period * 2 - 0.6, 0, 1)
    return sharp + (width / period - sharp) * blur


def _half(x: Column, period: Column | float, pixel: Column) -> Column:
    """Return 1 on every other half period and 0 between, blurred to the size of a pixel."""
    return _line(x, period, period / 2, pixel)


def _fade(pixel: Column, period: Column | float) -> Column:
    """Return 1 where detail of this size shows, 0 where a pixel holds several periods."""
    return np.clip(1.6 - 2 * pixel / period, 0, 1)


def _shade(colors: Colors, factor: Column) -> Colors:
    return colors * factor[:, None]


def _plain(s: Surface) -> Colors:
    return _shade(s.color, 0.92 + 0.16 * s.noise("cloud", 1.7))


def _plaster(s: Surface) -> Colors:
    fine = s.noise("speckle", 0.9)
    return _shade(s.color, 0.72 + 0.36 * s.noise("cloud", 5.0) + 0.2 * (fine - 0.5) + 0.1)


def _stained(s: Surface) -> Colors:
    return _shade(
        s.mix(np.clip(2.4 * s.noise("cloud", 2.5 * s.scale) - 0.7, 0, 1)), 0.8 + 0.4 * s.noise("speckle", 0.7)
    )


def _wood(s: Surface) -> Colors:
    grain = s.noise("grain", 0.55 * s.scale, stretch=1.6)
    rings = s.noise("cloud", 0.8 * s.scale, stretch=5.0)
    return s.mix(np.clip(1.5 * grain + 0.9 * rings - 0.85, 0, 1))


def _planks(s: Surface) -> Colors:
    width = 0.12 * s.scale
    row = np.floor(s.v / width)
    length = 9 * width
    shift = fractional(row, s.random) * length
    board = np.floor((s.u + shift) / length)
    tone = fractional(row, board, s.random)
    seam = np.maximum(_line(s.v, width, 0.004, s.pixel), _line(s.u + shift, length, 0.004, s.pixel))
    tone = 0.5 + (tone - 0.5) * _fade(s.pixel, width)
    colors = s.mix(np.clip(1.3 * s.noise("grain", 0.6, stretch=2.0) - 0.35 + 0.35 * (tone - 0.5), 0, 1))
    return _shade(colors, (0.8 + 0.4 * tone) * (1 - 0.65 * seam))


def _tiles(s: Surface) -> Colors:
    grout = np.maximum(
        _line(s.u, s.scale, 0.012 * s.scale + 0.003, s.pixel), _line(s.v, s.scale, 0.012 * s.scale + 0.003, s.pixel)
    )
    tone = fractional(np.floor(s.u / s.scale), np.floor(s.v / s.scale), s.random) - 0.5
    colors = _shade(s.color, 0.85 + 0.3 * s.noise("cloud", 1.1) + 0.12 * tone * _fade(s.pixel, s.scale))
    return colors + (s.second - colors) * grout[:, None]


def _bricks(s: Surface) -> Colors:
    height, length = 0.09 * s.scale, 0.26 * s.scale
    row = np.floor(s.v / height)
    u = s.u + (row % 2) * length / 2
    joint = np.maximum(_line(u, length, 0.012, s.pixel), _line(s.v, height, 0.012, s.pixel))
    tone = (fractional(np.floor(u / length), row, s.random) - 0.5) * _fade(s.pixel, height)
    colors = _shade(s.color, 0.75 + 0.5 * tone + 0.5 * s.noise("cloud", 2.0) * (0.7 + 0.6 * s.noise("speckle", 1.0)))
    return colors + (s.second - colors) * (0.85 * joint)[:, None]


def _checks(s: Surface) -> Colors:
    a, b = _half(s.u, s.scale, s.pixel), _half(s.v, s.scale, s.pixel)
    return _shade(s.mix(a + b - 2 * a * b), 0.85 + 0.3 * s.noise("cloud", 0.9))


def _plaid(s: Surface) -> Colors:
    a, b = _half(s.u, s.scale, s.pixel), _half(s.v, s.scale, s.pixel)
    fine = np.maximum(
        _line(s.u + 0.1 * s.scale, s.scale, 0.06 * s.scale, s.pixel), _line(s.v, s.scale, 0.06 * s.scale, s.pixel)
    )
    return _shade(s.mix((a + b) / 2), 1.0 - 0.35 * fine)


def _stripes(s: Surface) -> Colors:
    return _shade(s.mix(_half(s.u, s.scale, s.pixel)), 0.85 + 0.3 * s.noise("cloud", 0.8))


def _slats(s: Surface) -> Colors:
    phase = s.v / s.scale
    ramp = 0.5 + (phase - np.floor(phase) - 0.5) * _fade(s.pixel, s.scale)
    gap = _line(s.v, s.scale, 0.12 * s.scale, s.pixel)
    return _shade(s.mix(0.85 * gap), 0.75 + 0.4 * ramp)


def _dots(s: Surface) -> Colors:
    du, dv = s.u / s.scale, s.v / s.scale
    odd = np.floor(dv) % 2 / 2
    distance = np.hypot(du + odd - np.floor(du + odd) - 0.5, dv - np.floor(dv) - 0.5) * s.scale
    dot = np.clip((0.28 * s.scale - distance) / s.pixel + 0.5, 0, 1)
    blur = np.clip(2 * s.pixel / s.scale - 0.6, 0, 1)
    return s.mix(dot + (0.25 - dot) * blur)


def _fabric(s: Surface) -> Colors:
    weave = 0.5 * (np.sin(s.u * 900 / s.scale) * np.sin(s.v * 900 / s.scale)) * _fade(s.pixel, 0.008 * s.scale)
    return _shade(s.color, 0.7 + 0.2 * weave + 0.3 * s.noise("cloud", 0.8) + 0.3 * s.noise("speckle", 0.5))


def _carpet(s: Surface) -> Colors:
    return _shade(s.mix(np.clip(2 * s.noise("speckle", 0.9) - 0.7, 0, 1)), 0.75 + 0.5 * s.noise("cloud", 3.0))


def _ornament(s: Surface) -> Colors:
    edge = np.minimum(s.half_u - np.abs(s.u), s.half_v - np.abs(s.v))
    k = 2 * np.pi / s.scale
    motif = np.sin(k * s.u) * np.sin(k * s.v) + 0.6 * np.cos(2 * k * s.u) * np.cos(k * s.v + 3 * s.random)
    share = np.clip(0.5 + 1.5 * motif, 0, 1)
    border = np.minimum(s.half_u, s.half_v) * 0.28
    share = np.where(edge < border, np.clip(0.5 + 2 * np.sin(6.3 * edge / border + 2 * s.random), 0, 1), share)
    share = 0.5 + (share - 0.5) * _fade(s.pixel, s.scale / 2)
    return _shade(s.mix(share), 0.75 + 0.5 * s.noise("speckle", 0.5))


def _wallpaper(s: Surface) -> Colors:
    k = 2 * np.pi / s.scale
    bend = 2.5 * np.sin(k * s.v / 2 + 6 * s.random)
    motif = np.sin(k * s.u + bend) * np.sin(k * s.v) + 0.5 * np.sin(2 * k * s.u) * np.sin(2 * k * s.v - bend)
    share = 0.3 + (np.clip(0.5 + 2.5 * motif, 0, 1) - 0.3) * _fade(s.pixel, s.scale / 2)
    return _shade(s.mix(0.6 * share), 0.9 + 0.2 * s.noise("cloud", 4.0))


def _marble(s: Surface) -> Colors:
    warp = s.noise("cloud", 1.6 * s.scale)
    vein = 1 - np.abs(2 * s.noise("cloud", 0.9 * s.scale + 0 * warp) - 1) * 5
    return s.mix(np.clip(0.6 * np.clip(vein, 0, 1) + 0.8 * warp - 0.35, 0, 1))


def _terrazzo(s: Surface) -> Colors:
    return s.mix(np.clip(6 * s.noise("leaf", 0.7 * s.scale) - 3.4, 0, 1))


def _asphalt(s: Surface) -> Colors:
    patches, fine = s.noise("cloud", 23.0), s.noise("speckle", 3.0)
    crack = np.clip(1 - np.abs(s.noise("cloud", 31.0) - 0.5) * 90, 0, 1) * _fade(s.pixel, 0.2)
    return _shade(
        s.mix(np.clip(1.8 * s.noise("cloud", 67.0) - 0.5, 0, 1)),
        (0.65 + 0.4 * patches + 0.5 * (fine - 0.2)) * (1 - 0.4 * crack),
    )


def _grass(s: Surface) -> Colors:
    blades = s.noise("leaf", 2.2)
    return _shade(
        s.mix(np.clip(2.2 * s.noise("cloud", 19.0) - 0.6, 0, 1)), 0.25 + 0.8 * blades + 0.6 * s.noise("speckle", 1.7)
    )


def _foliage(s: Surface) -> Colors:
    leaf = s.noise("leaf", 1.6 * s.scale)
    return _shade(s.mix(np.clip(2.5 * s.noise("cloud", 2.0) - 0.7, 0, 1)), 0.1 + 1.5 * leaf)


def _bark(s: Surface) -> Colors:
    turned = Surface(s.v, s.u, s.pixel, s.half_v, s.half_u, s.scale, s.random, s.color, s.second, s.mirror)
    return s.mix(np.clip(2.2 * turned.noise("grain", 0.5, stretch=0.5) - 0.6, 0, 1))


def _shingles(s: Surface) -> Colors:
    height, width = 0.16 * s.scale, 0.22 * s.scale
    row = np.floor(s.v / height)
    u = s.u + (row % 2) * width / 2
    tone = (fractional(np.floor(u / width), row, s.random) - 0.5) * _fade(s.pixel, height)
    gap = np.maximum(_line(s.v, height, 0.03 * s.scale, s.pixel), 0.5 * _line(u, width, 0.02, s.pixel))
    return _shade(s.mix(np.clip(1.6 * s.noise("cloud", 6.0) - 0.5, 0, 1)), (1 + 0.5 * tone) * (1 - 0.6 * gap))


def _panels(s: Surface) -> Colors:
    joint = np.maximum(_line(s.u, 1.6 * s.scale, 0.02, s.pixel), _line(s.v, s.scale, 0.02, s.pixel))
    tone = (fractional(np.floor(s.u / (1.6 * s.scale) + 0.5), np.floor(s.v / s.scale + 0.5), s.random) - 0.5) * _fade(
        s.pixel, s.scale
    )
    return _shade(s.color, (0.75 + 0.25 * tone + 0.5 * s.noise("cloud", 4.0)) * (1 - 0.5 * joint))


def _facade(s: Surface) -> Colors:
    """Paint storeys of ``scale`` metres from the ground up, with windows of varied make."""
    style = [fractional(s.random, s.random * 0 + k) for k in range(5)]
    storey, bay = s.scale, s.scale * (0.55 + 0.6 * style[0])
    bay = 2 * s.half_u / np.maximum(np.round(2 * s.half_u / bay), 1)
    height = s.v + s.half_v
    column, row = np.floor((s.u + s.half_u) / bay), np.floor(height / storey)
    x, y = (s.u + s.half_u) / bay - column - 0.5, height / storey - row - 0.55
    pixel_x, pixel_y = s.pixel / bay, s.pixel / storey
    half_x, half_y = 0.22 + 0.2 * style[1], 0.24 + 0.16 * style[2]

    def inside(grow: float) -> Column:
        across = np.clip((half_x + grow - np.abs(x)) / pixel_x + 0.5, 0, 1)
        return across * np.clip((half_y + grow - np.abs(y)) / pixel_y + 0.5, 0, 1)

    above = row >= np.where(style[3] > 0.5, 1, 0)
    pane, frame = inside(0.0) * above, inside(0.035) * above
    bars = np.maximum(_line(x, 10.0, 0.03, pixel_x), _line(y - 0.1, 10.0, 0.03, pixel_y)) * (style[4] > 0.35)
    one = fractional(column, row, s.random)
    wall = _shade(s.color, 0.72 + 0.3 * s.noise("cloud", 6.0) + 0.25 * s.noise("speckle", 2.5))
    brick = 1 - 0.25 * np.maximum(_line(s.v, 0.09, 0.015, s.pixel), _line(s.u, 0.26, 0.012, s.pixel)) * (style[0] > 0.6)
    band = _line(height, storey, 0.12, s.pixel) * (style[2] > 0.45)
    wall = _shade(wall, brick)
    wall = wall + (s.second - wall) * (0.7 * band)[:, None]
    curtain = np.where(one > 0.6, 0.05 + 0.5 * (one - 0.6), 0.015)
    glass = np.stack([curtain, 1.05 * curtain + 0.008, 1.1 * curtain + 0.015], 1)
    colors = wall + (s.second - wall) * frame[:, None]
    clear = pane * (1 - bars)
    s.mirror[:] = s.mirror + (0.35 - s.mirror) * clear
    return colors + (glass - colors) * clear[:, None]


def _text(s: Surface) -> Colors:
    """Paint lines of strokes that look like writing from a distance."""
    line = s.scale
    row = np.floor(s.v / line)
    letter = np.floor(s.u / (0.6 * line))
    x, y = s.u / (0.6 * line) - letter, s.v / line - row
    one, other = fractional(letter, row, s.random), fractional(row, letter, s.random)
    upright = np.abs(x - 0.2 - 0.3 * one) < 0.12
    level = np.abs(y - 0.2 - 0.4 * other) < 0.09
    round_ = np.abs(np.hypot(x - 0.45, 1.4 * (y - 0.42)) - 0.3) < 0.09
    ink = np.where(one > 0.5, upright | level, round_ | (upright & (other > 0.5)))
    ink &= (y > 0.1) & (y < 0.75) & (fractional(letter, row + 31, s.random) > 0.18)
    edge = np.minimum(s.half_u - np.abs(s.u), s.half_v - np.abs(s.v))
    ink &= edge > 0.35 * line
    return s.mix(0.3 + (ink - 0.3) * _fade(s.pixel, line / 2))


def _picture(s: Surface) -> Colors:
    """Paint a picture of nothing in particular: sky, land and blots, or blots alone."""
    x, y = s.u / np.maximum(s.half_u, 1e-3), s.v / np.maximum(s.half_v, 1e-3)
    size = np.maximum(s.half_u, s.half_v)
    shift, footprint = s.random * 7.31, s.pixel / size
    blot = noise("cloud")(0.22 * x + shift, 0.22 * y + 2.1 * shift, 0.22 * footprint)
    fine = noise("leaf")(0.4 * x + shift, 0.4 * y + 4.1 * shift, 0.4 * footprint)
    horizon = np.clip(8 * (y - 0.4 * (s.random - 0.5) - 1.2 * (blot - 0.5)) + 0.5, 0, 1)
    layers = np.where(s.random > 0.4, horizon, np.clip(5 * blot - 2, 0, 1))
    hue = 6.28 * (s.random * 5 + 0.5 * blot[:] + 0.25 * layers)
    tint = 0.5 + 0.5 * np.cos(hue[:, None] + np.array([0, 2.1, 4.2], np.float32))
    return s.mix(layers) * (0.35 + 0.9 * tint) * (0.5 + fine)[:, None]


def _view(s: Surface) -> Colors:
    """Paint the outdoors, out of focus: a bright sky above dim green or houses."""
    y = s.v / np.maximum(s.half_v, 1e-3)
    blot, fine = s.noise("cloud", 6.0), s.noise("leaf", 5.0)
    land = np.clip(4 * (0.7 * s.random - 0.35 + 2.2 * (blot - 0.5) - y) + 0.5, 0, 1)
    ground = s.second * (0.15 + 0.9 * fine)[:, None]
    return s.color * (0.85 + 0.3 * blot)[:, None] * (1 - land)[:, None] + ground * land[:, None]


_PATTERNS: dict[str, Callable[[Surface], Colors]] = {
    "plain": _plain, "plaster": _plaster, "stained": _stained, "wood": _wood, "planks": _planks, "tiles": _tiles,
    "bricks": _bricks, "checks": _checks, "plaid": _plaid, "stripes": _stripes, "slats": _slats, "dots": _dots,
    "fabric": _fabric, "carpet": _carpet, "ornament": _ornament, "wallpaper": _wallpaper, "marble": _marble,
    "terrazzo": _terrazzo, "asphalt": _asphalt, "grass": _grass, "foliage": _foliage, "bark": _bark,
    "shingles": _shingles, "panels": _panels, "facade": _facade, "text": _text, "picture": _picture, "view": _view,
}  # fmt: skip
PATTERNS = tuple(_PATTERNS)
