"""A photo and the map that is stored about it, made into a sample."""

import numpy as np
import torch
from jaxtyping import Float32

from zoedepth.data.facts import Facts, check_camera
from zoedepth.data.fit import check_lies_alike, spread
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
    mask: StoredMap | None = None,
    mask_decides: bool = False,
    orientation: int = 1,
    name: str,
    files: tuple[object, object],
) -> Sample:
    """Make a sample of a photo and what is stored about it.

    The unit of depth is the first of ``facts.depth_scale``, what the file says, and, for whole numbers,
    ``default_scale``; floating point is metres otherwise. Values that are not finite or not positive are unknown, and
    so is depth of ``facts.max_depth`` or more.

    Args:
        photo: uint8 (height, width, 3).
        stored: the map, of the size of the photo, or smaller by the same factor both ways: then its values become
            points of the photo. None where nothing is known.
        kind: "depth" or "disparity".
        facts: the facts about this photo.
        default_scale: the stored value of one metre for files of whole numbers of which nobody says it.
        mask: the mask as ``read_mask`` returns it, False where the target is not valid; of the size of the photo or of
            the map.
        mask_decides: disparity that is not positive is known, too, where the mask (if there is one) says so.
        orientation: the EXIF orientation by which the photo was turned upright; see ``zoedepth.data.fit``.
        name: the name of the sample.
        files: names of the photo and of the target for messages.

    Raises:
        InputError: the camera cannot be that of the photo, sizes do not fit, nothing says whether the map was turned
            with the photo, nobody says the unit, or depth has 8 bits a pixel.
    """
    size = photo.shape[0], photo.shape[1]
    if facts.camera is not None:
        check_camera(facts.camera, size, files[0])
    if stored is not None:
        check_lies_alike(size, stored, names=files, orientation=orientation)
        if kind == "depth" and stored.relative:
            raise InputError(
                f"{files[1]} holds relative depth, which has no metres. Give a map of depth, or train stage 1 "
                "on it as disparity"
            )
    if mask is not None:
        names = (files[0], f"the mask of {files[1]}")
        check_lies_alike(size, mask, names=names, orientation=orientation)
        if stored is not None and mask.values.shape not in (size, stored.values.shape):
            raise InputError(
                f"the mask of {files[1]} is {mask.values.shape} (height, width): it must have the size of the photo, "
                f"{size}, or of the map, {stored.values.shape}"
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
    known = np.isfinite(target)
    if kind == "depth" and facts.max_depth is not None:
        known &= target < facts.max_depth
    if mask is None or not (mask_decides and kind == "disparity"):
        known &= target > 0
    target, known = spread(target, size), spread(known, size)
    if mask is not None:
        known &= spread(mask.values, size)
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
