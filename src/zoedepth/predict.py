"""From a photo to metres: everything around the model, which itself sees pixels of the network size only."""

import copy
import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from zoedepth import colors
from zoedepth.errors import InputError
from zoedepth.images import (
    PICTURE_SUFFIXES,
    DepthArray,
    ImageArray,
    png_scale,
    to_image,
    write_depth,
    write_image,
)
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.sizes import network_size

MAX_NETWORK_AREA = 16
"""A photo whose network input would be larger than this many times the trained size is refused."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The depth of one photo, at the photo's size."""

    depth: DepthArray
    """Metres along the optical axis (z, not the length of the ray); finite and positive everywhere."""
    std: DepthArray
    """Metres: standard deviation of the bin distribution, and of the two mirrored predictions where they differ."""
    domain: str
    """Scene type whose head made this depth, e.g. "indoor"."""
    domain_probability: dict[str, float]
    """The router's probability of each scene type; 1 for the only or the given one where there is no classifier."""
    image: ImageArray
    """The photo."""
    network_size: tuple[int, int]
    """(height, width) at which the model saw the photo."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the photo and of the depth."""
        return self.depth.shape[0], self.depth.shape[1]

    @property
    def confidence(self) -> DepthArray:
        """1 / (1 + std / depth), in (0, 1]: 1 is certain, 0.5 an uncertainty as large as the depth itself.

        It ranks pixels and photos; it is no probability, for nothing ties the spread of the bins to the true error.
        """
        return self.depth / (self.depth + self.std)

    def preview(self, *, vmin: float | None = None, vmax: float | None = None, colormap: str = "magma_r") -> ImageArray:
        """The photo beside its coloured depth with a bar in metres; see ``colors.preview``."""
        return colors.preview(self.image, self.depth, vmin=vmin, vmax=vmax, colormap=colormap)

    def save(self, path: str | Path, *, scale: float | None = None) -> None:
        """Write the depth in the format of the suffix, whole or not at all.

        .png: 16 bits, the scale in its text chunks (``images.read_depth`` reads it back). .npy: float32 metres. .npz:
        the same as ``depth``, beside ``std`` and ``confidence``. .jpg, .jpeg, .webp: the preview, a picture.

        Args:
            path: where to write; folders are made.
            scale: PNG levels per metre; None is 1000 (millimetres), or 256 where the depth exceeds 65.535 m.

        Raises:
            InputError: another suffix.
        """
        suffix = Path(path).suffix.lower()
        if suffix in PICTURE_SUFFIXES and suffix != ".png":
            write_image(path, self.preview())
            return
        scale = png_scale(self.depth) if scale is None else scale
        write_depth(path, self.depth, scale=scale, beside={"std": self.std, "confidence": self.confidence})


class Predictor:
    """Depth maps of photos of any size, as ZoeDepth was released: pad, resize, mirror average, resize back.

    It keeps no state between calls, so threads may share one. The model is not changed: on another device a copy is
    used.

    Args:
        model: in evaluation mode.
        flip_average: predict the mirrored photo too and average; twice the work, smoother edges, and the mirrored
            photo gives the mirrored depth.
        pad: reflect the photo's borders outwards before the network and cut them off after, against border artefacts.
        upsampling: of the depth to the photo's size: "bicubic" as the original's ``infer``, or "bilinear" (corners
            aligned) as its evaluation.
        device: where to run, "auto" for the best there is; None stays where the model is.
        precision: "bfloat16" runs the model under autocast; the output is float32 either way.

    Raises:
        InputError: unknown precision or device.
    """

    def __init__(
        self,
        model: ZoeDepth,
        *,
        flip_average: bool = True,
        pad: bool = True,
        upsampling: Literal["bicubic", "bilinear"] = "bicubic",
        device: str | torch.device | None = None,
        precision: Literal["float32", "bfloat16"] = "float32",
    ) -> None:
        if upsampling not in ("bicubic", "bilinear"):
            raise InputError(f"upsampling must be 'bicubic' or 'bilinear', got {upsampling!r}")
        if precision not in ("float32", "bfloat16"):
            raise InputError(f"precision must be 'float32' or 'bfloat16', got {precision!r}")
        self.device = model.device if device is None else _device(device)
        self.model = model if self.device == model.device else copy.deepcopy(model).to(self.device)
        self.flip_average = flip_average
        self.pad = pad
        self.upsampling = upsampling
        self.precision = precision

    def __call__(self, image: Any, *, domain: str | None = None) -> DepthMap:
        """Depth of one photo.

        Args:
            image: a path, an open file, a PIL image, an array (H, W, 3) or a tensor (3, H, W); see ``images.to_image``.
            domain: scene type whose head to use, e.g. "indoor"; None leaves it to the model's router.

        Raises:
            InputError: the image cannot be read, the domain is unknown, or the model is in training mode.
        """
        return self.batch([image], domain=domain)[0]

    def batch(self, images: Sequence[Any], *, domain: str | None = None, batch_size: int = 4) -> list[DepthMap]:
        """Depth of several photos: those of one network size go through the model together; the depths are the same.

        Args:
            images: any kinds and sizes, see ``__call__``.
            domain: scene type whose head to use for all of them; None leaves each to the router.
            batch_size: photos that go through the model at once.

        Raises:
            InputError: see ``__call__``.
        """
        if self.model.training:
            raise InputError("the model is in training mode, its depth would be random: call model.eval() first")
        head = None if domain is None else self.domain_index(domain)
        photos = [to_image(image) for image in images]
        groups: dict[tuple[int, int], list[int]] = {}
        for row, photo in enumerate(photos):
            groups.setdefault(self.network_size(photo.shape[:2]), []).append(row)
        results: dict[int, DepthMap] = {}
        for size, rows in groups.items():
            for start in range(0, len(rows), batch_size):
                chunk = rows[start : start + batch_size]
                results |= zip(chunk, self._predict([photos[row] for row in chunk], size, head), strict=True)
        return [results[row] for row in range(len(photos))]

    def network_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """(height, width) at which the model sees a photo of ``size`` (height, width).

        Raises:
            InputError: the photo is so long and narrow that this would exhaust memory.
        """
        config = self.model.config
        padding = self._padding(size)
        padded = (size[0] + 2 * padding[0], size[1] + 2 * padding[1])
        height, width = network_size(
            padded, config.size, multiple=config.multiple, keep_aspect_ratio=config.keep_aspect_ratio
        )
        if height * width > MAX_NETWORK_AREA * config.size[0] * config.size[1]:
            raise InputError(f"a photo of {size[1]} x {size[0]} pixels is too long and narrow: cut it into parts")
        return height, width

    def domain_index(self, domain: str) -> int:
        """Place of a scene type in the model's list.

        Raises:
            InputError: the model has no head for it.
        """
        names = [known.name for known in self.model.config.domains]
        if domain not in names:
            raise InputError(f"this model has no head for {domain!r}: use one of {names}")
        return names.index(domain)

    @torch.inference_mode()
    def _predict(self, photos: list[ImageArray], size: tuple[int, int], head: int | None) -> list[DepthMap]:
        """Depth of photos that share a network size."""
        pixels = torch.cat([self._pixels(photo, size) for photo in photos])
        given = None if head is None else torch.full((len(photos),), head, device=self.device)
        estimate = self._estimate_mirrored(pixels, given) if self.flip_average else self._estimate(pixels, given)
        return [self._depth_map(photo, estimate.of(row), size) for row, photo in enumerate(photos)]

    def _pixels(self, photo: ImageArray, size: tuple[int, int]) -> Float[Tensor, "1 3 _ _"]:
        vertical, horizontal = self._padding(photo.shape[:2])
        # numpy reflects as often as the padding needs, so that photos of a pixel or two work like any other.
        padded = np.pad(photo, ((vertical, vertical), (horizontal, horizontal), (0, 0)), mode="reflect")
        pixels = torch.from_numpy(padded).to(self.device).permute(2, 0, 1)[None].contiguous().float() / 255
        if self.model.config.antialias:
            return F.interpolate(pixels, size, mode="bilinear", align_corners=False, antialias=True).clamp(0, 1)
        return F.interpolate(pixels, size, mode="bilinear", align_corners=True)

    def _padding(self, size: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns added on each side, as released: 3 sqrt(side / 2)."""
        if not self.pad:
            return 0, 0
        return int(math.sqrt(size[0] / 2) * 3), int(math.sqrt(size[1] / 2) * 3)

    def _estimate(
        self, pixels: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " batch"] | None
    ) -> "_Estimate":
        reduced = torch.autocast(self.device.type, torch.bfloat16) if self.precision == "bfloat16" else nullcontext()
        with reduced:
            output = self.model(pixels, domain=domain, return_std=True)
        logits = None if output.domain_logits is None else output.domain_logits.float()
        return _Estimate(output.depth.float(), output.std.float().square(), output.domain, logits)

    def _estimate_mirrored(
        self, pixels: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " batch"] | None
    ) -> "_Estimate":
        """The mean over each photo and its mirror image, both through one head: that of their mean logits."""
        n = len(pixels)
        both = torch.cat([pixels, pixels.flip(-1)])
        depth, variance, taken, logits = self._estimate(both, None if domain is None else domain.repeat(2))
        if logits is not None:
            logits = (logits[:n] + logits[n:]) / 2
        if domain is None:
            domain = taken[:n] if logits is None else logits.argmax(dim=1)
            again = (taken != domain.repeat(2)).nonzero().flatten()
            if len(again):
                second = self._estimate(both[again], domain.repeat(2)[again])
                depth, variance = depth.clone(), variance.clone()
                depth[again], variance[again] = second.depth, second.variance
        straight, mirrored = depth[:n], depth[n:].flip(-1)
        spread = ((straight - mirrored) / 2) ** 2  # the variance of the two means adds to the mean of the two variances
        variance = (variance[:n] + variance[n:].flip(-1)) / 2 + spread
        return _Estimate((straight + mirrored) / 2, variance, domain, logits)

    def _depth_map(self, photo: ImageArray, estimate: "_Estimate", size: tuple[int, int]) -> DepthMap:
        """One photo's estimate at its own size, on the CPU."""
        domains = self.model.config.domains
        domain = domains[int(estimate.domain)]
        if estimate.logits is None:
            probability = {known.name: float(known is domain) for known in domains}
        else:
            softmax = estimate.logits[0].softmax(dim=0).tolist()
            probability = {known.name: p for known, p in zip(domains, softmax, strict=True)}
        depth = self._to_photo_size(estimate.depth, photo.shape[:2], mode=self.upsampling)
        # Bicubic interpolation overshoots at edges, in a near corner to below zero.
        depth = depth.clip(domain.min_depth, None)
        std = self._to_photo_size(estimate.variance.sqrt(), photo.shape[:2], mode="bilinear")
        return DepthMap(depth, std, domain.name, probability, photo, size)

    def _to_photo_size(self, x: Float[Tensor, "1 1 _ _"], size: tuple[int, int], *, mode: str) -> DepthArray:
        """Resize to the padded photo, and cut the padding off."""
        top, left = self._padding(size)
        padded_size = (size[0] + 2 * top, size[1] + 2 * left)
        padded = F.interpolate(x, padded_size, mode=mode, align_corners=mode == "bilinear")
        return np.ascontiguousarray(padded[0, 0, top : top + size[0], left : left + size[1]].cpu().numpy())


class _Estimate(NamedTuple):
    """What the model says of a batch, at network resolution."""

    depth: Float[Tensor, "batch 1 height width"]
    variance: Float[Tensor, "batch 1 height width"]
    domain: Int[Tensor, " batch"]
    logits: Float[Tensor, "batch domains"] | None

    def of(self, row: int) -> "_Estimate":
        """One photo's part."""
        one = slice(row, row + 1)
        logits = None if self.logits is None else self.logits[one]
        return _Estimate(self.depth[one], self.variance[one], self.domain[one], logits)


def _device(name: str | torch.device) -> torch.device:
    if name == "auto":
        accelerator = torch.accelerator.current_accelerator() if torch.accelerator.is_available() else None
        return accelerator or torch.device("cpu")
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:  # torch without CUDA asserts
        raise InputError(f"device {str(name)!r} cannot be used here: try 'cpu' or 'auto' ({error})") from error
