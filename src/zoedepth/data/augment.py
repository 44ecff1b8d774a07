"""Augmentations: functions of a sample and a random generator that change photo, target and mask alike.

``augment`` applies a list of them in order. An augmentation that moves pixels keeps the geometry honest: the target
stays the one that the camera would have measured.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.pixels import reflect_pad, resize_pixels

Augmentation = Callable[[Sample, np.random.Generator], Sample]


def augment(sample: Sample, augmentations: Sequence[Augmentation], rng: np.random.Generator) -> Sample:
    """Apply each augmentation in turn."""
    for augmentation in augmentations:
        sample = augmentation(sample, rng)
    return sample


def fit_crop(
    size: tuple[int, int],
    *,
    min_zoom: float = 1.0,
    max_zoom: float = 1.0,
    probability: float = 1.0,
    scale_depth: bool = True,
    sparse: bool = False,
    antialias: bool = True,
) -> Augmentation:
    """Cut a window of the shape of ``size`` out of the photo, and resize it to that size.

    Without zoom the window is the largest that fits: the network sees it at the scale at which it would see the whole
    photo. A zoom by z takes a window z times smaller, at a place drawn uniformly. For a camera of the same focal
    length that is a scene z times nearer, so depth is divided by z. Where z is below 1 the photo does not fill the
    window: it is in the middle, its borders are reflected outwards, and depth is unknown there.

    Args:
        size: (height, width) of the result.
        min_zoom: the smallest z, from 0.5 to 1; z is drawn log-uniformly between the two.
        max_zoom: the largest z, at least 1.
        probability: share of the samples that are zoomed; the others have z = 1.
        scale_depth: divide depth by z. False makes the zoom a change of focal length instead.
        sparse: depth is known at scattered points, which are all kept: see ``gather_points``.
        antialias: how the photo is resized, see ``zoedepth.pixels.resize_pixels``; depth goes with it.

    Raises:
        InputError: the zooms are out of range.
    """
    if not 0.5 <= min_zoom <= 1 <= max_zoom < math.inf:
        raise InputError(f"min_zoom must be from 0.5 to 1 and max_zoom at least 1; they are {min_zoom} and {max_zoom}")

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        zoomed = min_zoom < max_zoom and rng.random() < probability
        zoom = math.exp(rng.uniform(math.log(min_zoom), math.log(max_zoom))) if zoomed else 1.0
        height, width = sample.image.shape[-2:]
        scale = max(size[0] / height, size[1] / width) * zoom
        if zoom < 1:
            wanted = (round(size[0] / scale), round(size[1] / scale))
            sample = _framed(sample, max(0, wanted[0] - height + 1) // 2, max(0, wanted[1] - width + 1) // 2)
            height, width = sample.image.shape[-2:]
        window = (min(height, round(size[0] / scale)), min(width, round(size[1] / scale)))
        top, left = int(rng.integers(0, height - window[0] + 1)), int(rng.integers(0, width - window[1] + 1))
        return _resized_window(sample, top, left, window, size, zoom if scale_depth else 1.0, sparse, antialias)

    return apply


def window(size: tuple[int, int], *, sparse: bool = False, antialias: bool = True) -> Augmentation:
    """Cut a window of ``size`` pixels out of the photo at a random place, without resizing (BTS, AdaBins, PixelBins).

    A photo that is smaller gives its largest window of that shape, resized. ``sparse``, ``antialias``: see
    ``fit_crop``.
    """

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        height, width = sample.image.shape[-2:]
        scale = max(1.0, size[0] / height, size[1] / width)
        cut = (min(height, round(size[0] / scale)), min(width, round(size[1] / scale)))
        top, left = int(rng.integers(0, height - cut[0] + 1)), int(rng.integers(0, width - cut[1] + 1))
        return _resized_window(sample, top, left, cut, size, 1.0, sparse, antialias)

    return apply


def squeeze(
    size: tuple[int, int], *, sparse: bool = False, antialias: bool = True, keep_target: bool = False
) -> Augmentation:
    """Resize the whole photo to ``size``, whatever its shape (the released training).

    Args:
        size: (height, width) of the result.
        sparse, antialias: see ``fit_crop``.
        keep_target: leave depth and mask as large as they are: the loss is taken there (as released).
    """

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        height, width = sample.image.shape[-2:]
        resized = _resized_window(sample, 0, 0, (height, width), size, 1.0, sparse, antialias)
        return replace(resized, target=sample.target, mask=sample.mask) if keep_target else resized

    return apply


_KITTI_MOST = (400, 1280)
"""(height, width) of the largest photos that are taken for frames of KITTI."""


def kitti_crop() -> Augmentation:
    """Cut out the bottom centre 352x1216 (the "KB crop" of KITTI's depth benchmark).

    Photos that do not have the size of KITTI's frames (370 to 376 rows, 1224 to 1242 columns, by a few pixels more or
    less) stay as they are: of a photo of 12 megapixels the crop would leave 4 %.
    """

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        height, width = sample.image.shape[-2:]
        if not (352 <= height <= _KITTI_MOST[0] and 1216 <= width <= _KITTI_MOST[1]):
            return sample
        rows = slice(height - 352, height)
        left = int((width - 1216) / 2)
        columns = slice(left, left + 1216)
        cut = _map(sample, lambda x: x[:, rows, columns])
        return replace(cut, camera=sample.camera and sample.camera.cropped(rows.start, left))

    return apply


def flip(*, probability: float = 0.5) -> Augmentation:
    """Mirror left and right."""

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        if rng.random() >= probability:
            return sample
        camera = sample.camera and sample.camera.mirrored(sample.image.shape[-1])
        return replace(_map(sample, lambda x: x.flip(-1)), camera=camera)

    return apply


def rotate(*, degrees: float = 1.0) -> Augmentation:
    """Turn about the centre by an angle drawn from +-``degrees``. Corners that come from outside are black and unknown.

    The camera stays the same, as if its principal point were the centre.
    """

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        angle = math.radians(rng.uniform(-degrees, degrees))
        height, width = sample.image.shape[-2:]
        # affine_grid counts in halves of the picture's sides.
        cos, sin = math.cos(angle), math.sin(angle)
        theta = torch.tensor([[[cos, -sin * height / width, 0], [sin * width / height, cos, 0]]])
        grid = F.affine_grid(theta, [1, 1, height, width], align_corners=False)
        image = F.grid_sample(sample.image[None], grid, mode="bilinear", align_corners=False)[0]
        target = F.grid_sample(sample.target[None], grid, mode="nearest", align_corners=False)[0]
        mask = F.grid_sample(sample.mask[None].float(), grid, mode="nearest", align_corners=False)[0] > 0.5
        return replace(sample, image=image, target=target, mask=mask)

    return apply


def jitter_colors(
    *,
    probability: float = 0.5,
    gamma: tuple[float, float] = (0.9, 1.1),
    brightness: tuple[float, float] = (0.75, 1.25),
    channel_gain: tuple[float, float] = (0.9, 1.1),
    saturation: tuple[float, float] = (1.0, 1.0),
) -> Augmentation:
    """Change gamma, brightness, the gain of each channel (all as released), and saturation (0 is grey)."""

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        if rng.random() >= probability:
            return sample
        gains = torch.tensor(rng.uniform(*channel_gain, size=(3, 1, 1)), dtype=torch.float32)
        image = sample.image ** rng.uniform(*gamma) * rng.uniform(*brightness) * gains
        grey = image.mean(dim=0, keepdim=True)
        return replace(sample, image=(grey + (image - grey) * rng.uniform(*saturation)).clamp(0, 1))

    return apply


def assume_camera(focal_px: float) -> Augmentation:
    """Give a photo without a camera one with square pixels that looks through its middle.

    Args:
        focal_px: focal length in pixels of the photo as it is.

    Raises:
        InputError: the focal length is not above 0 and finite.
    """
    if not 0 < focal_px < math.inf:
        raise InputError(f"focal_px must be above 0 and finite, in pixels of the photos; it is {focal_px}")

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        if sample.camera is not None:
            return sample
        height, width = sample.image.shape[-2:]
        return replace(sample, camera=Intrinsics(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2))

    return apply


def canonical_camera(focal_px: Mapping[str, float], *, data: str, assume: bool = False) -> Augmentation:
    """Scale depth to the one camera of its domain: by the focal length there / that of the photo (Metric3D, eq. 1).

    It belongs behind all that changes the size of the photo. A zoom is then a change of the lens, whether or not it
    changed the depth. Disparity stays.

    Args:
        focal_px: domain → focal length of its one camera, pixels of the photo at its present size. Where there is one
            domain only, it takes all photos.
        data: name of the data set, for the error.
        assume: a photo without a camera is taken to come from the one camera; its depth stays.

    Raises:
        InputError: when it is applied to a photo without a camera, unless ``assume`` is True.
    """

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        if sample.kind == "disparity" or (sample.camera is None and assume):
            return sample
        camera = sample.camera
        if camera is None:
            raise InputError(no_camera(data, sample.name))
        wanted = focal_px[sample.domain] if len(focal_px) > 1 else next(iter(focal_px.values()))
        factor = wanted / camera.fy  # see zoedepth.sizes.network_focal
        camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
        return replace(sample, target=sample.target * factor, camera=camera)

    return apply


def no_camera(data: str, name: str) -> str:
    """Return the message for a photo without a camera in a training that needs to know it."""
    return (
        f"{data} says no camera for {name}, and this model learns metres in one canonical camera. Give fx, fy, cx, cy "
        "in the list or in dataset.json, or focal_px of the source, in pixels of its photos; if nobody knows it, set "
        "without_camera of the source to 'assume': such photos are then taken to come from the canonical camera"
    )


def limit_depth(min_depth: float, max_depth: float) -> Augmentation:
    """Make depth at or beyond these bounds (metres) unknown. Disparity stays."""

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        if sample.kind == "disparity":
            return sample
        return replace(sample, mask=sample.mask & (sample.target > min_depth) & (sample.target < max_depth))

    return apply


def to_disparity() -> Augmentation:
    """Turn depth into disparity 1 / depth, and scale each image's known values to [0, 1] (MiDaS; stage 1 only)."""

    def apply(sample: Sample, rng: np.random.Generator) -> Sample:
        inverse = 1 / sample.target.clamp(min=1e-3) if sample.kind == "depth" else sample.target
        if not sample.mask.any():
            return replace(sample, target=torch.zeros_like(sample.target), kind="disparity")
        known = inverse[sample.mask]
        spread = (known.max() - known.min()).clamp(min=1e-6)
        target = torch.where(sample.mask, (inverse - known.min()) / spread, 0.0)
        return replace(sample, target=target, kind="disparity")

    return apply


def _map(sample: Sample, change: Callable[[torch.Tensor], torch.Tensor]) -> Sample:
    """Change the pixel grid of photo, target and mask alike."""
    return replace(sample, image=change(sample.image), target=change(sample.target), mask=change(sample.mask))


def _framed(sample: Sample, vertical: int, horizontal: int) -> Sample:
    """Reflect the photo's borders outwards by so many rows and columns on each side; no depth is known there."""
    around = (horizontal, horizontal, vertical, vertical)
    return replace(
        sample,
        image=reflect_pad(sample.image[None], vertical, horizontal)[0],
        target=F.pad(sample.target, around),
        mask=F.pad(sample.mask, around),
        camera=sample.camera and sample.camera.cropped(-vertical, -horizontal),
    )


def _resized_window(
    sample: Sample,
    top: int,
    left: int,
    window: tuple[int, int],
    size: tuple[int, int],
    zoom: float,
    sparse: bool,
    antialias: bool,
) -> Sample:
    cropped = _map(sample, lambda x: x[:, top : top + window[0], left : left + window[1]])
    camera = sample.camera and sample.camera.cropped(top, left).scaled(size[0] / window[0], size[1] / window[1])
    image = resize_pixels(cropped.image[None], size, antialias=antialias)[0]
    # Without the filter corners lie on corners, and depth lies where the photo does.
    aligned = not antialias
    if sparse:
        nearest_is_smallest = sample.kind == "depth"
        target, mask = gather_points(
            cropped.target, cropped.mask, size, nearest_is_smallest=nearest_is_smallest, aligned=aligned
        )
    elif aligned:
        rows, columns = (_nearest_of_aligned(n, side) for n, side in zip(size, window, strict=True))
        target, mask = (x[:, rows][:, :, columns] for x in (cropped.target, cropped.mask))
    else:
        # Nearest pixel: the mean of a near and a far depth is the depth of neither.
        target = F.interpolate(cropped.target[None], size, mode="nearest-exact")[0]
        mask = F.interpolate(cropped.mask[None].float(), size, mode="nearest-exact")[0] > 0.5
    target = target / zoom if sample.kind == "depth" else target
    if camera and zoom != 1:
        # The scene comes nearer through the same lens: the picture is the same, the focal length is not.
        camera = replace(camera, fx=camera.fx / zoom, fy=camera.fy / zoom)
    return replace(sample, image=image.clamp(0, 1), target=target, mask=mask, camera=camera)


def _nearest_of_aligned(n: int, side: int) -> Int[Tensor, " n"]:
    """Return the pixel of a side that is nearest to each of ``n``, where first lies on first and last on last."""
    return (torch.linspace(0, side - 1, n) + 0.5).long().clamp(max=side - 1)


def gather_points(
    target: Float[Tensor, "1 height width"],
    mask: Bool[Tensor, "1 height width"],
    size: tuple[int, int],
    *,
    nearest_is_smallest: bool,
    aligned: bool = False,
) -> tuple[Float[Tensor, "1 _ _"], Bool[Tensor, "1 _ _"]]:
    """Bring scattered depth to another size: each known point goes to its pixel, where the nearest of several wins.

    Args:
        target: depth, or disparity.
        mask: True where it is known.
        size: (height, width) of the result.
        nearest_is_smallest: True for depth, False for disparity.
        aligned: first pixel lies on first and last on last; without it, edges lie on edges.
    """
    rows, columns = mask[0].nonzero(as_tuple=True)
    values = target[0, rows, columns]
    if aligned:
        places = [
            (x * (n - 1) / max(side - 1, 1) + 0.5).long()
            for x, n, side in zip((rows, columns), size, mask.shape[1:], strict=True)
        ]
    else:
        places = [x * n // side for x, n, side in zip((rows, columns), size, mask.shape[1:], strict=True)]
    pixel = places[0] * size[1] + places[1]
    found = torch.full((size[0] * size[1],), torch.inf if nearest_is_smallest else -torch.inf)
    found = found.scatter_reduce(0, pixel, values, "amin" if nearest_is_smallest else "amax").view(1, *size)
    known = found.isfinite()
    return found.masked_fill(~known, 0), known
