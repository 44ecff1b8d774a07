"""From readings to a calibration, of one photo or of several of one camera."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.calibration.calibration import Calibration, other_camera
from zoedepth.calibration.posterior import PHOTO_ERROR, Posterior, fit_camera, fit_scale
from zoedepth.calibration.power import MIN_READINGS, fit_line, power_helps
from zoedepth.calibration.readings import Distance, Measured, Point, Reading, measure, roughness_at, spread_of
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth
from zoedepth.images import DepthArray

Form = Literal["scale", "scale-shift"]
"""scale: depth * scale. scale-shift: scale and shift of the logarithm of depth, which is scale * depth ** power."""

SCALE_LEVEL, PIXEL_LEVEL = 0.95, 0.88
"""Probabilities, by what is known of errors, that are stated as ``COVERAGE``: photos have more ways to be wrong."""

_PLACES = 16  # pixels along a side of the photo at which roughness is looked at


def calibrate(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    *,
    camera: Camera | None = None,
    valid: Bool[np.ndarray, "height width"] | None = None,
    along_ray: bool = False,
    form: Form = "scale",
    photo: str = "",
    earlier: Calibration | None = None,
) -> Calibration:
    """Find the scale that brings a depth map to what was measured.

    The result holds for this photo. With the readings of other photos (``earlier``) it holds for their camera: scales
    of photos of one camera scatter by 15 % (``posterior.PHOTO_ERROR``), so that one tells little of the others.

    Args:
        depth: (height, width), metres, as the model gives it.
        readings: (x, y, metres) of pixels, and ((x, y), (x, y), metres) of the distance of two points, in any mixture;
            or a sparse depth map of the depth's size, metres, 0 or NaN where nothing was measured; or an array (N, 3)
            of x, y and metres. The centre of the top left pixel is at (0, 0).
        camera: the camera of the photo at this size. Distances and ``along_ray`` need it.
        valid: True where depth can be compared; elsewhere readings are refused, and those of a map passed over.
        along_ray: readings of single points are the length of the ray from the lens to the thing, as a tape measure or
            a laser at the camera gives it, and not depth along the optical axis.
        form: "scale-shift" also fits a power, where the readings, left out one after the other, say that this predicts
            them better; elsewhere, the scale alone. It is for one photo.
        photo: name of the photo, to tell its readings from those of others.
        earlier: calibration of other photos of the same camera, model and scene type, of which the readings are taken
            over. Readings of a photo of this name are replaced.

    Raises:
        InputError: no reading; one that is outside of the photo, at a pixel without valid depth, or not above 0; a
            camera that is missing or of another size; or an earlier calibration of another camera, or with a power.
    """
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.size == 0:
        raise InputError(f"depth must be an array (height, width), got one of shape {depth.shape}")
    if camera is not None:
        check_size(depth, camera)
    if valid is not None and valid.shape != depth.shape:
        raise InputError(f"valid has shape {valid.shape}, and depth {depth.shape}: they must be the same")
    known = known_depth(depth) if valid is None else known_depth(depth) & valid
    measured = measure(depth, readings, camera, known, along_ray=along_ray)
    before = measured.compared(1.0)
    found = zip(measured.points, measured.metres.tolist(), before.tolist(), strict=True)
    new = tuple(
        replace(
            Reading(points, metres, value, value, photo=photo),
            at_jump=bool(measured.at_jump[i]),
            spread=float(measured.spread[i]),
        )
        for i, (points, metres, value) in enumerate(found)
    )
    others = () if earlier is None else _others(earlier, photo, camera, form)
    together = others + new
    fit = _fit(together, np.log(measured.depth[:, 0]), measured, form)
    after = fit.scale * np.array([*(each.before for each in others), *measured.compared(fit.power)])
    spreads = _spreads(depth, known)
    here = PHOTO_ERROR**2 if others else 0.0
    elsewhere = PHOTO_ERROR**2 if others else 2 * PHOTO_ERROR**2  # that of the photo itself is in the scale, too
    posterior = fit.posterior
    return Calibration(
        scale=fit.scale,
        power=fit.power,
        scale_error=math.expm1(posterior.reach(SCALE_LEVEL)),
        expected_error=math.expm1(posterior.pixel_reach(spreads, PIXEL_LEVEL, photo_variance=here)),
        error_elsewhere=math.expm1(posterior.pixel_reach(spreads, PIXEL_LEVEL, photo_variance=elsewhere)),
        n_readings=len(together) + (0 if earlier is None else _n_unlisted(earlier, photo)),
        middle=float(np.median(measured.depth[:, 0])),
        readings=tuple(
            replace(reading, after=float(metres), outlier=not fits)
            for reading, metres, fits in zip(together, after, fit.kept, strict=True)
        ),
        camera=camera,
    )


class _Fit(NamedTuple):
    scale: float
    power: float
    posterior: Posterior
    kept: Bool[np.ndarray, " readings"]


def _fit(readings: Sequence[Reading], depth: Float[np.ndarray, " new"], measured: Measured, form: Form) -> _Fit:
    """Fit the scale, and the power where it is asked for and predicts readings better that were left out."""
    spread = np.array([reading.spread for reading in readings])
    ratios = np.array([math.log(reading.metres / reading.before) for reading in readings])
    names = [reading.photo for reading in readings]
    if len(set(names)) > 1:
        posterior, kept = fit_camera(ratios, spread, np.unique(names, return_inverse=True)[1])
        return _Fit(math.exp(posterior.middle), 1.0, posterior, kept)
    posterior, kept = fit_scale(ratios, spread)
    if form == "scale-shift":
        if not measured.single:
            raise InputError("a distance of two points tells the scale alone: for scale-shift, give points")
        if len(depth) >= MIN_READINGS and power_helps(depth, ratios, spread, posterior.sigma):
            line = fit_line(depth, ratios, spread)
            scale = math.exp(line.posterior.middle - (line.power - 1) * line.middle)
            return _Fit(scale, line.power, line.posterior, line.kept)
    return _Fit(math.exp(posterior.middle), 1.0, posterior, kept)


def _others(earlier: Calibration, photo: str, camera: Camera | None, form: Form) -> tuple[Reading, ...]:
    """Return the readings of other photos in an earlier calibration. Those of no name, as of the service, are of one.

    Raises:
        InputError: they cannot be taken together with readings of this photo.
    """
    if form != "scale" or earlier.power != 1:
        raise InputError("scale-shift is fitted to the readings of one photo: for several, fit the scale alone")
    if not photo:
        raise InputError("name each photo (photo=) where readings of several are taken together")
    if earlier.camera is not None and camera is not None and (reason := other_camera(earlier.camera, camera)):
        raise InputError(f"readings in photos of two cameras cannot be taken together: {reason}")
    return tuple(reading for reading in earlier.readings if reading.photo != photo)


def _n_unlisted(earlier: Calibration, photo: str) -> int:
    """Return how many readings of other photos an earlier calibration has that it does not list.

    It does not say of which photos they are: as many of each as of those that it lists.
    """
    unlisted = earlier.n_readings - len(earlier.readings)
    kept = sum(reading.photo != photo for reading in earlier.readings)
    return round(unlisted * kept / max(1, len(earlier.readings)))


def _spreads(depth: DepthArray, known: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, " pixels"]:
    """Return how uncertain pixels are that stand for all of the photo."""
    rows, columns = (np.linspace(0, side - 1, min(side, _PLACES)).round().astype(int) for side in depth.shape)
    rows, columns = (places.ravel() for places in np.meshgrid(rows, columns, indexing="ij"))
    here = known[rows, columns]
    if not here.any():
        return np.ones(1)
    spreads = spread_of(roughness_at(depth, known, rows[here], columns[here]))
    return np.quantile(spreads, (np.arange(_PLACES) + 0.5) / _PLACES)
