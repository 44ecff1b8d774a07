"""Jumps of depth: where a camera sees past the border of a thing to what is behind it.

Neither networks nor resized depth maps have sharp jumps: between the two surfaces lies a ramp of some pixels, which
belong to nobody and fly in the air. A ramp differs from a floor that is seen nearly along it by its ends: the floor
goes on as steep as it is. The inverse depth of a plane is a linear function of the pixel's place (its differences are
equal everywhere), so that ramps show by differences that are larger than those at both sides.
"""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth

Focal = float | Float[np.ndarray, "rows 1"]

STEEP = 3.0
"""Change in depth for a step across the line of sight, both in metres, beyond which a surface is suspected to be none:
it would be seen under less than 18 degrees, and what is at its sides would not go on so."""

_REACH = (4, 7, 11)  # pixels from the middle of a ramp to where it should have ended; wider ramps: see ``_FEWEST``
_SHARP = (2, 3)  # the same for jumps between two pixels
_GAP = 2  # pixels on top of a thin thing, between the ramps at its sides, that are no surface of their own
_NEAR = 5  # pixels around one of a ramp in which a surface at its depth shows that it is no flying pixel
# A larger picture is looked at in steps of 2, 4, ... pixels, too, while it has ``_FEWEST`` along its longer side. With
# fewer than ``_MANY``, what is within ``_REACH`` is no small part of the picture, and must be steeper to be a ramp.
_MANY, _FEWEST, _WIDE_STEEP = 600, 300, 6.0
_BLOCK = 1 << 18  # pixels that are worked on at once
_DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (0.7, 0.7), (0.7, -0.7), (-0.7, 0.7), (-0.7, -0.7))


def inverse_depth(depth: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Return 1 / depth, and NaN where there is no depth."""
    known = known_depth(depth)
    with np.errstate(over="ignore"):  # of the least numbers above 0
        return np.divide(1, depth, out=np.full(depth.shape, np.nan, np.float32), where=known, casting="same_kind")


def tolerance(depth: Float[np.ndarray, "*places"]) -> Float[np.ndarray, "*places"]:
    """Return how far apart in depth, in metres, two points may lie that are of one surface.

    That is 4.5 cm from 1.5 to 9 m; less where all is near (3 % of the depth), and more where all is far (0.5 %).
    """
    return np.maximum(np.minimum(0.045, 0.03 * depth), 0.005 * depth)


def jumps(
    depth: Float[np.ndarray, "height width"], camera: Camera
) -> tuple[Bool[np.ndarray, "height gaps_across"], Bool[np.ndarray, "gaps_along width"]]:
    """Return where two neighbouring pixels do not see one surface: (those in a row, those in a column).

    That is so where their depths differ by more than ``tolerance``, and the surface between them would be ``STEEP``,
    other than at either side; or where one has no depth.

    Raises:
        InputError: the camera is that of another size.
    """
    check_size(depth, camera)
    return find_jumps(depth, camera.fx, camera.fy)


def flying_pixels(depth: Float[np.ndarray, "height width"], camera: Camera) -> Bool[np.ndarray, "height width"]:
    """Return True at pixels that hang in the air between a near surface and a far one, as networks leave at borders.

    They lie in a ramp of the depth, and no surface near them in the picture has their depth (within ``tolerance``).

    Args:
        depth: metres along the optical axis.
        camera: the camera at the size of the depth map.

    Raises:
        InputError: the camera is that of another size.
    """
    check_size(depth, camera)
    return find_flying(depth, camera.fx, camera.fy)


def find_jumps(
    depth: Float[np.ndarray, "height width"], across: Focal, along: float
) -> tuple[Bool[np.ndarray, "height gaps_across"], Bool[np.ndarray, "gaps_along width"]]:
    """Return where two neighbouring pixels do not see one surface, as ``jumps`` does, for any kind of camera.

    Args:
        depth: metres along the optical axis; for panoramas, along the ray.
        across: pixels of a row that a radian straight ahead takes; one number for each row (rows, 1) where they differ.
        along: pixels of a column that a radian straight ahead takes.
    """
    inverse = inverse_depth(depth)
    return _gaps(inverse, across), _gaps(inverse.T, along).T


def find_flying(
    depth: Float[np.ndarray, "height width"], across: Focal, along: float
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels that hang in the air, as ``flying_pixels`` does, for any kind of camera: see ``find_jumps``."""
    flying = np.zeros(depth.shape, bool)
    step = 1
    while step == 1 or (max(depth.shape) >= _FEWEST * step and min(depth.shape) > step // 2):
        coarse = depth[step // 2 :: step, step // 2 :: step]
        coarse_across = across[step // 2 :: step] if isinstance(across, np.ndarray) else across
        steep = STEEP if step == 1 or max(depth.shape) >= _MANY * step else _WIDE_STEEP
        found = _flying(coarse, coarse_across / step, along / step, steep)
        flying |= found if step == 1 else _enlarged(found, step, depth.shape)
        step *= 2
    return flying


def _gaps(inverse: Float32[np.ndarray, "rows columns"], focal: Focal) -> Bool[np.ndarray, "rows gaps"]:
    """Return where neighbours of a row are not of one surface."""
    gaps = np.ones((inverse.shape[0], max(0, inverse.shape[1] - 1)), bool)
    for some in _blocks(inverse.shape):
        values = np.ascontiguousarray(inverse[some])
        rises, falls = _steep(values, _of_rows(focal, some), _SHARP, STEEP)
        before, after = values[:, :-1], values[:, 1:]
        with np.errstate(invalid="ignore", divide="ignore"):
            near = 1 / np.maximum(before, after)
            apart = 1 / np.minimum(before, after) - near > tolerance(near)
        gaps[some] = ((rises | falls) & apart) | np.isnan(before) | np.isnan(after)
    return gaps


def _flying(
    depth: Float[np.ndarray, "height width"], across: Focal, along: float, steep: float
) -> Bool[np.ndarray, "height width"]:
    """Return the flying pixels in ramps of a few pixels."""
    inverse = inverse_depth(depth)
    ramp = _ramps(inverse, across, steep)
    ramp |= _ramps(inverse.T, along, steep).T
    surface = ~ramp & ~np.isnan(inverse)
    row, column = np.nonzero(ramp)
    z = depth[row, column]
    allowed = tolerance(z)
    height, width = depth.shape
    for pixels in range(1, _NEAR + 1):
        for down, right in _DIRECTIONS:
            y = row + round(pixels * down)
            x = column + round(pixels * right)
            np.clip(y, 0, height - 1, out=y)
            np.clip(x, 0, width - 1, out=x)
            flies = ~(surface[y, x] & (np.abs(depth[y, x] - z) < allowed))
            if not flies.all():
                row, column, z, allowed = row[flies], column[flies], z[flies], allowed[flies]
    flying = np.zeros(depth.shape, bool)
    flying[row, column] = True
    return flying


def _ramps(
    inverse: Float32[np.ndarray, "rows columns"], focal: Focal, steep: float
) -> Bool[np.ndarray, "rows columns"]:
    """Return the pixels that lie in the midst of a ramp along their row."""
    ramp = np.zeros(inverse.shape, bool)
    if inverse.shape[1] < 2:
        return ramp
    for some in _blocks(inverse.shape):
        rises, falls = _steep(np.ascontiguousarray(inverse[some]), _of_rows(focal, some), _REACH, steep)
        gaps = _filled(_of_two(rises) | _of_two(falls))
        ramp[some, 1:-1] = gaps[:, 1:] & gaps[:, :-1]
        ramp[some, :1], ramp[some, -1:] = gaps[:, :1], gaps[:, -1:]
    return ramp


def _steep(
    inverse: Float32[np.ndarray, "rows columns"], focal: Focal, reach: tuple[int, ...], steep: float
) -> tuple[Bool[np.ndarray, "rows gaps"], Bool[np.ndarray, "rows gaps"]]:
    """Return where the inverse depth (rises, falls) steeply between neighbours of a row, other than at both sides.

    Args:
        focal: focal length along the rows, pixels.
        reach: distances in pixels at which the sides are looked at; it is enough if one finds the difference.
        steep: see ``STEEP``.
    """
    steps = np.diff(inverse, axis=1)
    least = np.minimum(inverse[:, 1:], inverse[:, :-1]) * np.asarray(steep / focal, np.float32)
    n, margin = steps.shape[1], max(reach)
    rises, falls = np.zeros(steps.shape, bool), np.zeros(steps.shape, bool)
    if not n:
        return rises, falls
    # What has no depth goes on as a surface seen straight on; comparisons with NaN are False.
    sides = np.pad(np.nan_to_num(steps), ((0, 0), (margin, margin)), mode="edge")
    with np.errstate(invalid="ignore"):
        for distance in reach:
            before, after = sides[:, margin - distance :][:, :n], sides[:, margin + distance :][:, :n]
            rises |= steps - np.maximum(before, after) > least
            falls |= np.minimum(before, after) - steps > least
    return rises, falls


def _of_two(gaps: Bool[np.ndarray, "rows gaps"]) -> Bool[np.ndarray, "rows gaps"]:
    """Return those gaps that are True beside another: one alone is a sharp jump, which has no pixel in its midst."""
    pair = gaps[:, 1:] & gaps[:, :-1]
    result = np.zeros_like(gaps)
    result[:, 1:] = pair
    result[:, :-1] |= pair
    return result


def _filled(gaps: Bool[np.ndarray, "rows gaps"]) -> Bool[np.ndarray, "rows gaps"]:
    """Return True for up to ``_GAP`` gaps between others that are True, too."""
    n = gaps.shape[1]
    padded = np.pad(gaps, ((0, 0), (_GAP, _GAP)))
    result = gaps.copy()
    for before in range(1, _GAP + 1):
        for after in range(1, _GAP + 2 - before):
            result |= padded[:, _GAP - before :][:, :n] & padded[:, _GAP + after :][:, :n]
    return result


def _enlarged(coarse: Bool[np.ndarray, "rows columns"], step: int, size: tuple[int, ...]) -> np.ndarray:
    """Return a map of every ``step``-th pixel at the full size: each pixel as the nearest that was looked at."""
    row, column = (
        np.minimum(np.arange(side) // step, n - 1) for side, n in zip(size, coarse.shape, strict=True)
    )  # the pixel that is looked at is the middle one of its block
    return coarse[row][:, column]


def _of_rows(focal: Focal, rows: slice) -> Focal:
    return focal[rows] if isinstance(focal, np.ndarray) else focal


def _blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Return rows in blocks that fit into the processor's cache."""
    n = max(1, math.ceil(_BLOCK / max(1, shape[1])))
    for start in range(0, shape[0], n):
        yield slice(start, start + n)
