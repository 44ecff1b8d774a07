"""Forwards of exported models, without torch: as ``tensors``, and equal to it up to rounding."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32, Int

from zoedepth.forward.answer import Answer, Photos, in_groups
from zoedepth.images import DepthArray, ImageArray
from zoedepth.resizing import Mode, reflect_pad, resize, to_pixels
from zoedepth.sizes import border
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.tensors import Exported


@dataclass(frozen=True)
class ArrayForward:
    """The forward of an exported model for photos; see ``Predictor`` for its options."""

    model: ExportedModel
    pad: bool
    flip_average: bool
    upsampling: Literal["bicubic", "bilinear"]

    def predict(self, photos: Photos, head: int | None, *, batch_size: int) -> list[Answer]:
        """Predict photos, those of one network size together, for its runtime has threads of its own.

        Args:
            photos: photos of any sizes.
            head: index of the head that they take; None leaves each to the router.
            batch_size: photos that are computed at the same time, at most.
        """

        def predict(images: list[ImageArray], size: tuple[int, int]) -> list[Answer]:
            pixels = np.stack([self._to_network(image, size) for image in images])
            said, taken = self._run(pixels, None if head is None else np.full(len(images), head))
            return [self._answer(image, said, row, int(taken[row])) for row, image in enumerate(images)]

        return in_groups(predict, photos, batch_size)

    def relative(self, image: ImageArray, size: tuple[int, int]) -> DepthArray:
        """Refuse: exported files hold metres only.

        Raises:
            InputError: always.
        """
        return self.model.relative(image)

    def _to_network(self, image: ImageArray, size: tuple[int, int]) -> Float32[np.ndarray, "3 height width"]:
        if self.pad:
            image = reflect_pad(image, *border((image.shape[0], image.shape[1])))
        return to_pixels(image, size, antialias=self.model.config.antialias)

    def _run(
        self, pixels: Float32[np.ndarray, "batch 3 height width"], domain: Int[np.ndarray, " batch"] | None
    ) -> tuple[Exported, Int[np.ndarray, " batch"]]:
        """Return what the model says at network resolution, and the heads that it took."""
        if not self.flip_average:
            said = self.model.compute(pixels, domain)
            return said, _taken(said, domain)
        n = len(pixels)
        both = np.concatenate([pixels, pixels[..., ::-1]])
        said = self.model.compute(both, None if domain is None else np.tile(domain, 2))
        logits = said.domain_logits
        if domain is not None or logits is None:
            return _mirror_mean(said, n), _taken(said, domain)[:n]
        # Both through one head: that of their mean logits.
        wanted = np.tile((logits[:n] + logits[n:]).argmax(axis=1), 2)
        again = np.flatnonzero(logits.argmax(axis=1) != wanted)
        if len(again):
            second = self.model.compute(both[again], wanted[again])
            said.predicted_depth[again] = second.predicted_depth
            if said.std is not None:
                said.std[again] = second.std
        return _mirror_mean(said, n), wanted[:n]

    def _answer(self, image: ImageArray, said: Exported, row: int, domain: int) -> Answer:
        depth = self._from_network(said.predicted_depth[row], image, self.upsampling)
        std = None if said.std is None else self._from_network(said.std[row], image, "bilinear")
        probability = None
        if said.domain_logits is not None:
            odds = np.exp(said.domain_logits[row] - said.domain_logits[row].max())
            probability = [float(each) for each in odds / odds.sum()]
        return Answer(depth, std, domain, probability)

    def _from_network(self, x: DepthArray, image: ImageArray, mode: Mode) -> DepthArray:
        """Resize a map to the size of the padded photo, and cut the padding off."""
        height, width = image.shape[:2]
        top, left = border((height, width)) if self.pad else (0, 0)
        padded = resize(x, (height + 2 * top, width + 2 * left), mode)
        return np.ascontiguousarray(padded[top : top + height, left : left + width])


def _taken(said: Exported, domain: Int[np.ndarray, " batch"] | None) -> Int[np.ndarray, " batch"]:
    """Return the heads that images took: those that were asked for, or the router's choice."""
    if domain is not None:
        return domain
    if said.domain_logits is None:
        return np.zeros(len(said.predicted_depth), int)
    return said.domain_logits.argmax(axis=1)


def _mirror_mean(said: Exported, n: int) -> Exported:
    """Return the mean of what a model says of ``n`` photos and of their mirror images, which follow them."""
    one, other = said.predicted_depth[:n], said.predicted_depth[n:, :, ::-1]
    std, logits = said.std, said.domain_logits
    if std is not None:
        spread = ((one - other) / 2) ** 2  # the variance of the two means adds to the mean of the two variances
        std = np.sqrt((std[:n] ** 2 + std[n:, :, ::-1] ** 2) / 2 + spread)
    if logits is not None:
        logits = (logits[:n] + logits[n:]) / 2
    return Exported((one + other) / 2, std, logits)
