"""Forwards of models in torch, and of exported ones inside of programs in torch."""

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field
from threading import Lock
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.forward.answer import Answer, Photos, Precision, in_groups
from zoedepth.images import DepthArray, ImageArray
from zoedepth.model.interface import DepthModel, DepthOutput
from zoedepth.pixels import reflect_pad, resize_pixels
from zoedepth.sizes import border
from zoedepth.threads import threads_kept
from zoedepth.weights.exported import ExportedModel


@dataclass(frozen=True)
class TensorForward:
    """The forward of a model for photos; see ``Predictor`` for its options."""

    model: DepthModel | ExportedModel
    pad: bool
    flip_average: bool
    upsampling: Literal["bicubic", "bilinear"]
    precision: Precision
    _turn: Lock = field(default_factory=Lock, repr=False, compare=False)
    """Held by the thread whose photos are on the accelerator: many at once would need its memory many times."""

    def predict(self, photos: Photos, head: int | None, *, batch_size: int) -> list[Answer]:
        """Predict photos: on an accelerator, those of one network size together; on the CPU, each on cores of its own.

        Args:
            photos: photos of any sizes.
            head: index of the head that they take; None leaves each to the router.
            batch_size: photos that are computed at the same time, at most.

        Raises:
            InputError: the model is in training mode.
        """
        self._check_mode()
        if self._one_by_one:
            return self._side_by_side(photos, head, workers=batch_size)
        return in_groups(lambda images, size: self._predict(images, size, head), photos, batch_size)

    @torch.inference_mode()
    def relative(self, image: ImageArray, size: tuple[int, int]) -> DepthArray:
        """Predict the relative depth of one photo that the network sees at a size (height, width).

        Raises:
            InputError: the model has none, or is in training mode.
        """
        self._check_mode()
        pixels = self._to_network(self._pixels(image), size)
        relative = self._relative(pixels)
        if self.flip_average:
            relative = (relative + self._relative(pixels.flip(-1)).flip(-1)) / 2
        return _to_array(self._from_network(relative, image.shape[:2], mode=self.upsampling)).clip(0, None)

    def infer(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        size: tuple[int, int],
        domain: Int[Tensor, " batch"] | None,
    ) -> tuple[Float[Tensor, "batch 1 height width"], list[int]]:
        """Return the depth of photos that the network sees at a size (height, width), and the heads that they took.

        Raises:
            InputError: the model is in training mode.
        """
        self._check_mode()
        output = self._run(self._to_network(pixels.to(self.model.device).float(), size), domain)
        return self._from_network(output.depth, pixels.shape[2:], mode=self.upsampling), output.domain.tolist()

    def _side_by_side(self, photos: Photos, head: int | None, *, workers: int) -> list[Answer]:
        """Predict photos at the same time, each on its share of torch's threads."""
        with threads_kept() as threads:
            workers = min(workers, threads, len(photos))
            if workers < 2:
                return [self._predict([image], size, head)[0] for image, size in photos]
            share = threads // workers
            with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(share,)) as executor:
                return list(executor.map(lambda photo: self._predict([photo[0]], photo[1], head)[0], photos))

    @torch.inference_mode()
    def _predict(self, images: Sequence[ImageArray], size: tuple[int, int], head: int | None) -> list[Answer]:
        """Predict photos that share a network size. On an accelerator, threads take turns."""
        with nullcontext() if self.model.device.type == "cpu" else self._turn:
            pixels = torch.cat([self._to_network(self._pixels(image), size) for image in images])
            given = None if head is None else torch.full((len(images),), head, device=pixels.device)
            output = self._run(pixels, given)
            return [self._answer(image, _rows(output, slice(row, row + 1))) for row, image in enumerate(images)]

    @property
    def _one_by_one(self) -> bool:
        """True where a photo by itself is faster than in a batch, and gives the same depth."""
        return self.model.device.type == "cpu" and not self._votes_together

    @property
    def _votes_together(self) -> bool:
        """True where the photos of a batch share a head."""
        config = self.model.config
        return isinstance(config, ModelConfig) and config.router.vote == "batch"

    def _check_mode(self) -> None:
        if isinstance(self.model, DepthModel) and self.model.training:
            raise InputError("the model is in training mode, its depth would be random: call model.eval() first")

    def _pixels(self, image: ImageArray) -> UInt8[Tensor, "1 3 height width"]:
        # Copied, because torch takes no array that is read-only or flipped.
        return torch.tensor(np.ascontiguousarray(image)).to(self.model.device).permute(2, 0, 1)[None]

    def _to_network(
        self,
        pixels: Float[Tensor, "batch 3 height width"] | UInt8[Tensor, "batch 3 height width"],
        size: tuple[int, int],
    ) -> Float[Tensor, "batch 3 _ _"]:
        """Pad the photos, and resize them to what the network takes."""
        if self.pad:
            pixels = reflect_pad(pixels, *border((pixels.shape[2], pixels.shape[3])))
        if not pixels.is_floating_point():
            pixels = pixels.float().div_(255)  # in place: 90 megapixels take a gigabyte
        return resize_pixels(pixels, size, antialias=self.model.config.antialias)

    def _from_network(
        self, x: Float[Tensor, "batch 1 _ _"], size: Sequence[int], *, mode: str
    ) -> Float[Tensor, "batch 1 height width"]:
        """Resize a map to the size of the padded photo, and cut the padding off."""
        height, width = size
        top, left = border((height, width)) if self.pad else (0, 0)
        padded_size = (height + 2 * top, width + 2 * left)
        padded = F.interpolate(x, padded_size, mode=mode, align_corners=mode == "bilinear")
        return padded[:, :, top : top + height, left : left + width]

    def _autocast(self) -> "torch.autocast | nullcontext":
        if self.precision == "float32":
            return nullcontext()
        return torch.autocast(self.model.device.type, getattr(torch, self.precision))

    def _relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        with self._autocast():
            return self.model.relative(pixels).float()

    def _run(self, pixels: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " batch"] | None) -> DepthOutput:
        """Return depth and std at network resolution, averaged with those of the mirror images if so asked."""
        return self._run_mirrored(pixels, domain) if self.flip_average else self._run_once(pixels, domain)

    def _run_once(
        self, pixels: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " batch"] | None
    ) -> DepthOutput:
        """Return what the model says of the pixels as they are, in float32."""
        with self._autocast():
            output = self.model(pixels, domain=domain, return_std=True)
        logits = None if output.domain_logits is None else output.domain_logits.float()
        std = None if output.std is None else output.std.float()
        return output._replace(depth=output.depth.float(), std=std, domain_logits=logits)

    def _run_mirrored(
        self, pixels: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " batch"] | None
    ) -> DepthOutput:
        """Return the mean over each photo and its mirror image, both through one head: that of their mean logits."""
        if self._votes_together:
            # As released: the photos vote, and then, by themselves, their mirror images.
            straight, mirrored = self._run_once(pixels, domain), self._run_once(pixels.flip(-1), domain)
            return _mirror_mean(straight, mirrored, domain=straight.domain)
        n = len(pixels)
        both = torch.cat([pixels, pixels.flip(-1)])
        output = self._run_once(both, None if domain is None else domain.repeat(2))
        logits, taken = output.domain_logits, output.domain
        if domain is None:
            domain = taken[:n] if logits is None else (logits[:n] + logits[n:]).argmax(dim=1)
            again = (taken != domain.repeat(2)).nonzero().flatten()
            if len(again):
                second = self._run_once(both[again], domain.repeat(2)[again])
                depth, std = output.depth.clone(), output.std
                depth[again] = second.depth
                if std is not None and second.std is not None:
                    std = std.clone()
                    std[again] = second.std
                output = output._replace(depth=depth, std=std)
        return _mirror_mean(_rows(output, slice(n)), _rows(output, slice(n, None)), domain=domain)

    def _answer(self, image: ImageArray, output: DepthOutput) -> Answer:
        """Return what the model says of one photo at the photo's own size, on the CPU."""
        size, logits = image.shape[:2], output.domain_logits
        return Answer(
            _to_array(self._from_network(output.depth, size, mode=self.upsampling)),
            None if output.std is None else _to_array(self._from_network(output.std, size, mode="bilinear")),
            int(output.domain),
            None if logits is None else logits[0].softmax(dim=0).tolist(),
        )


def on_device(model: DepthModel, device: str | torch.device | None) -> DepthModel:
    """Return a model on a device, "auto" for the best there is: a copy, if it is on another. None leaves it there.

    Raises:
        InputError: the device is unknown, or not there.
    """
    wanted = model.device if device is None else _device(device)
    return model if wanted == model.device else copy.deepcopy(model).to(wanted)


def _rows(output: DepthOutput, some: slice) -> DepthOutput:
    """Return what a model says of some photos of a batch: depth, std, domain and its logits."""
    std = None if output.std is None else output.std[some]
    logits = None if output.domain_logits is None else output.domain_logits[some]
    return DepthOutput(output.depth[some], None, output.domain[some], logits, std, None, None)


def _mirror_mean(straight: DepthOutput, mirrored: DepthOutput, *, domain: Int[Tensor, " batch"]) -> DepthOutput:
    """Return the mean of what a model says of photos and of their mirror images.

    Args:
        straight: the model's output for the photos.
        mirrored: the model's output for the photos mirrored left and right, not yet mirrored back.
        domain: index of the head that both took.
    """
    one, other = straight.depth, mirrored.depth.flip(-1)
    std, logits = None, straight.domain_logits
    if straight.std is not None and mirrored.std is not None:
        spread = ((one - other) / 2) ** 2  # the variance of the two means adds to the mean of the two variances
        std = ((straight.std.square() + mirrored.std.square().flip(-1)) / 2 + spread).sqrt()
    if logits is not None and mirrored.domain_logits is not None:
        logits = (logits + mirrored.domain_logits) / 2
    return DepthOutput((one + other) / 2, None, domain, logits, std, None, None)


def _to_array(x: Float[Tensor, "1 1 height width"]) -> DepthArray:
    return np.ascontiguousarray(x[0, 0].cpu().numpy())


def _device(name: str | torch.device) -> torch.device:
    if name == "auto":
        accelerator = torch.accelerator.current_accelerator() if torch.accelerator.is_available() else None
        return accelerator or torch.device("cpu")
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:  # torch without CUDA asserts
        raise InputError(f"device {str(name)!r} cannot be used here: try 'cpu' or 'auto' ({error})") from error
