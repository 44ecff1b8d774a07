"""A photo and the map that is stored about it, made into a sample."""

import numpy as np
import torch
from jaxtyping import Bool, Float32

from zoedepth.data.facts import Facts
from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.images import ImageArray
from zoedepth.stored import StoredMap


def to_sample(
    photo: ImageArray,
    stored: StoredMap | None,
    *,
    kind: Target,
    facts: Facts,
    default_scale: float | None = None,
    mask: Bool[np.ndarray, "height width"] | None = None,
    mask_decides: bool = False,
    name: str,
    files: tuple[object, object],
) -> Sample:
    """Make a sample of a photo and what is stored about it.

    The unit of depth is the first of ``facts.depth_scale``, what the file says, and, for whole numbers,
    ``default_scale``; floating point is metres otherwise. Values that are not finite or not positive are unknown, and
    so is depth of ``facts.max_depth`` or more.

    Args:
        photo: uint8 (height, width, 3).
        stored: the map, of the size of the photo; None where nothing is known.
        kind: "depth" or "disparity".
        facts: the facts about this photo.
        default_scale: the stored value of one metre for files of whole numbers of which nobody says it.
        mask: False where the target is not valid.
        mask_decides: disparity that is not positive is known, too, where the mask (if there is one) says so.
        name: the name of the sample.
        files: names of the photo and of the target for messages.

    Raises:
        InputError: sizes differ, nobody says the unit, or depth has 8 bits a pixel.
    """
    size = photo.shape[:2]
    for what, found in (("", None if stored is None else stored.values), ("the mask of ", mask)):
        if found is not None and found.shape != size:
            raise InputError(
                f"{files[0]} is {size} and {what}{files[1]} is {found.shape} (height, width): sizes must agree"
            )
    target = np.zeros(size, np.float32)
    if stored is not None:
        if kind == "depth" and stored.values.dtype.itemsize < 2:
            raise InputError(
                f"{files[1]} has 8 bits a pixel: it is a picture of depth, not a depth map. Give one channel of 16 "
                "bits or floating point"
            )
        default = default_scale if stored.values.dtype.kind != "f" else None  # a list of PNGs may have floats in it
        scale = 1.0 if kind == "disparity" else facts.depth_scale or stored.scale or default
        target = _divided(stored.values, scale, files[1])
    known = np.isfinite(target) & (mask if mask is not None else target > 0)
    if kind == "depth" and facts.max_depth is not None:
        known &= target < facts.max_depth
    if not (mask_decides and kind == "disparity"):
        known &= target > 0
    return Sample(
        image=torch.tensor(photo).permute(2, 0, 1).float() / 255,
        target=torch.from_numpy(np.where(known, target, np.float32(0)))[None],
        mask=torch.from_numpy(known)[None],
        kind=kind,
        domain=facts.domain or "",
        name=name,
        camera=facts.camera,
    )


def _divided(values: np.ndarray, scale: float | None, name: object) -> Float32[np.ndarray, "height width"]:
    if scale is None:
        if values.dtype.kind != "f":
            raise InputError(f"{name} has whole numbers and does not say how many are one metre: give depth_scale")
        scale = 1.0
    with np.errstate(over="ignore"):  # float64 beyond float32 is as unknown as infinity
        return values.astype(np.float32) / np.float32(scale)
