"""From a photo to metres: everything around the model, which itself sees only pixels of the network size."""

import copy
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from zoedepth.config import Domain, ModelConfig
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.choice import CameraChoice, CameraChoices, check_choice, choice_for_each, known_without_notes
from zoedepth.geometry.exif import read_exif_camera
from zoedepth.images import DepthArray, ImageArray, to_image, to_image_with_notes
from zoedepth.model.interface import DepthModel, DepthOutput
from zoedepth.pixels import check_pixels, reflect_pad, resize_pixels
from zoedepth.sizes import network_focal, network_size

MAX_NETWORK_AREA = 16
"""A photo whose network input would be larger than this many times the trained size is refused."""

ASSUMED_FOV_X = 60.0
"""Degrees from left to right that a photo is assumed to have where neither it nor the model's config says anything."""


class _Photo(NamedTuple):
    """A photo that is about to be predicted."""

    image: ImageArray
    network_size: tuple[int, int]
    camera: Camera | None
    """None where nobody knows it."""
    camera_note: str
    """Its notes in a few words, see ``DepthMap.camera_note``."""


class Predictor:
    """Predict depth maps of photos of any size, as ZoeDepth was released: (pad,) resize, mirror average, resize back.

    A predictor keeps no state between calls, so threads may share one. It does not change the model: for another device
    it makes a copy.

    Args:
        model: a model in evaluation mode.
        flip_average: predict the mirrored photo too and average. It takes twice the work, gives smoother edges, and the
            mirrored photo gives the mirrored depth.
        pad: reflect the photo's borders outwards before the network and cut them off after, against border artefacts.
            None does what the model's config says.
        upsampling: how the depth is resized to the photo's size: "bicubic" as in the original's ``infer``, or
            "bilinear" (corners aligned) as in its evaluation.
        resize: "keep-aspect" or "squeeze" the photo, see ``ModelConfig.resize``. None does what the config says.
        device: where to run, "auto" for the best there is. None stays where the model is.
        precision: "bfloat16" runs the model under autocast; the output is float32 either way.
        camera: the camera of the photos, where a call does not say another. "exif" reads it from each photo's notes. A
            ``Camera`` is that of photos of its size; photos of the same proportions are taken for resized ones. A
            ``Lens`` (a field of view, or a focal length) holds for photos of any size. "none" asks nobody. Where nobody
            knows it, the camera of the model's training photos is assumed, and ``DepthMap.camera.source`` says so.
        focal_correction: True multiplies depth by the photo's focal length over that of the training photos, both in
            pixels of the network's input: a lens that magnifies twice brings things, as the model sees them, to half
            their distance. False does not. None does it where the model was trained in one canonical camera
            (``config.canonical_camera``), and where the camera is given, if the config knows the focal length of the
            training photos. An assumed camera corrects nothing.

    Raises:
        InputError: unknown precision, device or camera; or ``focal_correction`` is True, and the model's config does
            not say the focal length of its training photos (``Domain.focal_px``).
    """

    def __init__(
        self,
        model: DepthModel,
        *,
        flip_average: bool = True,
        pad: bool | None = None,
        upsampling: Literal["bicubic", "bilinear"] = "bicubic",
        resize: Literal["keep-aspect", "squeeze"] | None = None,
        device: str | torch.device | None = None,
        precision: Literal["float32", "bfloat16"] = "float32",
        camera: CameraChoice = "exif",
        focal_correction: bool | None = None,
    ) -> None:
        if upsampling not in ("bicubic", "bilinear"):
            raise InputError(f"upsampling must be 'bicubic' or 'bilinear', got {upsampling!r}")
        if precision not in ("float32", "bfloat16"):
            raise InputError(f"precision must be 'float32' or 'bfloat16', got {precision!r}")
        check_choice(camera)
        unknown = [domain.name for domain in model.config.domains if domain.focal_px is None]
        if focal_correction and unknown:
            raise InputError(
                f"the config of this model does not say with what focal length it was trained for {', '.join(unknown)} "
                "(Domain.focal_px), so that depth cannot be corrected by the focal length of the photo: leave "
                "focal_correction out (--focal-correction)"
            )
        exported = next(model.parameters(), None) is None  # such a model stays where its runtime is
        if exported and device is not None and str(device) not in ("auto", "cpu"):
            raise InputError(f"an exported model cannot be moved to {str(device)!r}: leave the device out")
        self.device = model.device if device is None or exported else _device(device)
        self.model = model if self.device == model.device else copy.deepcopy(model).to(self.device)
        self.flip_average = flip_average
        self.pad = model.config.pad if pad is None else pad
        self.upsampling = upsampling
        self.keep_aspect_ratio = model.config.keep_aspect_ratio and resize != "squeeze"
        if resize == "keep-aspect" and not model.config.one_size:
            self.keep_aspect_ratio = True
        self.precision = precision
        self.camera: CameraChoice = camera
        self.focal_correction = focal_correction

    @property
    def corrects_known_cameras(self) -> bool:
        """True where depth is corrected by the focal length if the notes of a photo tell its camera."""
        wanted = self.model.config.canonical_camera if self.focal_correction is None else self.focal_correction
        return self.camera == "exif" and wanted

    def __call__(self, image: Any, *, domain: str | None = None, camera: CameraChoice | None = None) -> DepthMap:
        """Predict the depth of one photo.

        Args:
            image: a path, an open file, a PIL image, an RGB array (H, W, 3) or RGB tensor (3, H, W); see
                ``images.to_image``. BGR cannot be told from RGB and gives a worse depth without a word: turn what
                OpenCV reads round, ``image[..., ::-1]``.
            domain: scene type whose head to use, e.g. "indoor"; None leaves it to the model's router.
            camera: the camera of this photo, see ``Predictor``; None is that of the predictor.

        Raises:
            InputError: the image cannot be read, the camera is that of a photo of other proportions, the domain is
                unknown, or the model is in training mode.
        """
        return self.batch([image], domain=domain, camera=camera)[0]

    def batch(
        self,
        images: Sequence[Any],
        *,
        domain: str | None = None,
        camera: CameraChoices = None,
        batch_size: int = 4,
    ) -> list[DepthMap]:
        """Predict several photos. The depths are those of one photo at a time.

        On an accelerator those of one network size go through the model together. On the CPU that would take longer
        than one after the other, so there each has cores of its own.

        Args:
            images: photos of any kinds and sizes, RGB, see ``__call__``.
            domain: scene type whose head to use for all of them; None leaves each to the router.
            camera: the camera of all photos, or a list with that of each; None is that of the predictor.
            batch_size: photos that are computed at the same time. Each takes memory.

        Raises:
            InputError: ``images`` is no list, there are not as many cameras as photos, or ``batch_size`` is less than
                1; otherwise see ``__call__``.
        """
        self._check_mode()
        if isinstance(images, str | bytes | Path):
            raise InputError(f"batch takes a list of photos, got {type(images).__name__}: put one photo into brackets")
        if batch_size < 1:
            raise InputError(f"batch_size must be 1 or more, got {batch_size}")
        head = None if domain is None else self.domain_index(domain)
        cameras = choice_for_each(camera, len(images))
        photos = [self._photo(image, choice) for image, choice in zip(images, cameras, strict=True)]
        if self._one_by_one:
            return self._side_by_side(photos, head, workers=batch_size)
        groups: dict[tuple[int, int], list[int]] = {}
        for row, photo in enumerate(photos):
            groups.setdefault(photo.network_size, []).append(row)
        results: dict[int, DepthMap] = {}
        for rows in groups.values():
            for start in range(0, len(rows), batch_size):
                chunk = rows[start : start + batch_size]
                results |= zip(chunk, self._predict([photos[row] for row in chunk], head), strict=True)
        return [results[row] for row in range(len(photos))]

    def infer(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        camera: CameraChoices = None,
    ) -> Float[Tensor, "batch 1 height width"]:
        """Predict the depth of a tensor of photos of one size, as the original's ``infer``, for pipelines in torch.

        Gradients flow back to the pixels. Bicubic upsampling may overshoot at edges, to below zero for near things.

        Args:
            pixels: RGB in [0, 1], of any size, on any device, not normalised: the model does that.
            domain: index of the head each photo takes; None leaves it to the model's router.
            camera: the camera of all photos, or a list with that of each, see ``Predictor``; None is that of the
                predictor. Tensors have no notes: where it is "exif", nothing is corrected.

        Returns:
            Metres, float32, on the predictor's device.

        Raises:
            InputError: wrong shape, type or range, a camera of a photo of other proportions, or the model is in
                training mode.
        """
        check_pixels(pixels)
        self._check_mode()
        size = (pixels.shape[2], pixels.shape[3])
        network_size = self.network_size(size)
        choices: list[CameraChoice] = [
            self.camera if each is None else each for each in choice_for_each(camera, len(pixels))
        ]
        cameras = [known_without_notes(choice, size) for choice in choices]
        output = self._run(self._to_network(pixels.to(self.device).float(), network_size), domain)
        depth = self._from_network(output.depth, size, mode=self.upsampling)
        if all(known is None for known in cameras):
            return depth
        heads = [self.model.config.domains[head] for head in output.domain.tolist()]
        factors = [self._focal_factor(*each, network_size) for each in zip(cameras, heads, strict=True)]
        return depth * depth.new_tensor(factors)[:, None, None, None]

    @torch.inference_mode()
    def relative(self, image: Any) -> DepthArray:
        """Predict the relative depth of one photo: inverse depth up to an unknown scale and shift, near is large.

        MiDaS gives this map, and stage 1 trains it. Stage 2 trains metres alone, and no loss keeps this map right then:
        for a model with metric heads it only shows what the decoder makes of the photo.

        Args:
            image: the photo, see ``__call__``.

        Returns:
            float32 (height, width), the photo's size, >= 0, without a unit.

        Raises:
            InputError: see ``__call__``.
        """
        self._check_mode()
        photo = to_image(image)
        size = (photo.shape[0], photo.shape[1])
        pixels = self._to_network(self._pixels(photo), self.network_size(size))
        relative = self._relative(pixels)
        if self.flip_average:
            relative = (relative + self._relative(pixels.flip(-1)).flip(-1)) / 2
        return _to_array(self._from_network(relative, size, mode=self.upsampling)).clip(0, None)

    def network_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the (height, width) at which the model sees a photo of ``size`` (height, width).

        Raises:
            InputError: the photo is so long and narrow that the model would exhaust the memory.
        """
        config = self.model.config
        padding = self._padding(size)
        padded = (size[0] + 2 * padding[0], size[1] + 2 * padding[1])
        height, width = network_size(
            padded, config.size, multiple=config.multiple, keep_aspect_ratio=self.keep_aspect_ratio
        )
        if height * width > MAX_NETWORK_AREA * config.size[0] * config.size[1]:
            raise InputError(f"a photo of {size[1]} x {size[0]} pixels is too long and narrow: cut it into parts")
        return height, width

    def domain_index(self, domain: str) -> int:
        """Return the place of a scene type in the model's list.

        Raises:
            InputError: the model has no head for this scene type.
        """
        names = [known.name for known in self.model.config.domains]
        if domain not in names:
            raise InputError(f"this model has no head for {domain!r}: use one of {names}")
        return names.index(domain)

    def _photo(self, image: Any, choice: CameraChoice | None) -> _Photo:
        """Read a photo, and find out its camera."""
        note, choice = "", self.camera if choice is None else choice
        if isinstance(choice, str) and choice == "exif":
            photo, notes = to_image_with_notes(image)
            known = read_exif_camera(notes, _size(photo))
            camera, note = known.camera, known.reason
        else:
            photo = to_image(image)
            camera = known_without_notes(choice, _size(photo))
        return _Photo(photo, self.network_size(_size(photo)), camera, note)

    def _assumed(self, size: tuple[int, int], domain: Domain, network_size: tuple[int, int]) -> Camera:
        """Return the camera that a photo of ``size`` is taken to have: that of the training photos, if it is known."""
        if domain.focal_px is None:
            return Camera.from_fov(size, horizontal=ASSUMED_FOV_X, source="assumed")
        at_one = self._focal_in_network(Camera.from_focal(1.0, size), network_size)
        return Camera.from_focal(domain.focal_px / at_one, size, source="assumed")

    def _focal_factor(self, camera: Camera | None, domain: Domain, network_size: tuple[int, int]) -> float:
        """Return what the depth of a photo is multiplied by because of its camera."""
        if camera is None or camera.source == "assumed" or domain.focal_px is None:
            return 1.0
        wanted = self.focal_correction
        if wanted is None:
            wanted = self.model.config.canonical_camera or camera.source == "given"
        return self._focal_in_network(camera, network_size) / domain.focal_px if wanted else 1.0

    def _focal_in_network(self, camera: Camera, network_size: tuple[int, int]) -> float:
        """Return the focal length that a photo has as the network sees it, in pixels of the network's input."""
        height = camera.size[0] + 2 * self._padding(camera.size)[0]
        return network_focal(camera.fy, height, network_size[0])

    @torch.inference_mode()
    def _predict(self, photos: list[_Photo], head: int | None) -> list[DepthMap]:
        """Predict photos that share a network size."""
        size = photos[0].network_size
        pixels = torch.cat([self._to_network(self._pixels(photo.image), size) for photo in photos])
        given = None if head is None else torch.full((len(photos),), head, device=self.device)
        output = self._run(pixels, given)
        return [self._depth_map(photo, _rows(output, slice(row, row + 1))) for row, photo in enumerate(photos)]

    @property
    def _one_by_one(self) -> bool:
        """True where a photo by itself is faster than in a batch, and gives the same depth."""
        config = self.model.config
        votes_together = isinstance(config, ModelConfig) and config.router.vote == "batch"
        exported = next(self.model.parameters(), None) is None  # its runtime has threads of its own
        return self.device.type == "cpu" and not votes_together and not exported

    def _side_by_side(self, photos: list[_Photo], head: int | None, *, workers: int) -> list[DepthMap]:
        """Predict photos at the same time, each on its share of torch's threads."""
        threads = torch.get_num_threads()
        workers = min(workers, threads, len(photos))
        if workers < 2:
            return [self._predict([photo], head)[0] for photo in photos]
        share = threads // workers
        try:
            with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(share,)) as executor:
                return list(executor.map(lambda photo: self._predict([photo], head)[0], photos))
        finally:
            torch.set_num_threads(threads)  # what a thread sets holds for all that start later

    def _check_mode(self) -> None:
        if self.model.training:
            raise InputError("the model is in training mode, its depth would be random: call model.eval() first")

    def _pixels(self, photo: ImageArray) -> UInt8[Tensor, "1 3 height width"]:
        # Copied, because torch takes no array that is read-only or flipped.
        return torch.tensor(np.ascontiguousarray(photo)).to(self.device).permute(2, 0, 1)[None]

    def _to_network(
        self,
        pixels: Float[Tensor, "batch 3 height width"] | UInt8[Tensor, "batch 3 height width"],
        size: tuple[int, int],
    ) -> Float[Tensor, "batch 3 _ _"]:
        """Pad the photos, and resize them to what the network takes."""
        vertical, horizontal = self._padding((pixels.shape[2], pixels.shape[3]))
        pixels = reflect_pad(pixels, vertical, horizontal)
        if not pixels.is_floating_point():
            pixels = pixels.float().div_(255)  # in place: 90 megapixels take a gigabyte
        return resize_pixels(pixels, size, antialias=self.model.config.antialias)

    def _from_network(
        self, x: Float[Tensor, "batch 1 _ _"], size: tuple[int, int], *, mode: str
    ) -> Float[Tensor, "batch 1 height width"]:
        """Resize a map to the size of the padded photo, and cut the padding off."""
        top, left = self._padding(size)
        padded_size = (size[0] + 2 * top, size[1] + 2 * left)
        padded = F.interpolate(x, padded_size, mode=mode, align_corners=mode == "bilinear")
        return padded[:, :, top : top + size[0], left : left + size[1]]

    def _padding(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return how many rows and columns are added on each side, as released: 3 sqrt(side / 2)."""
        if not self.pad:
            return 0, 0
        return int(math.sqrt(size[0] / 2) * 3), int(math.sqrt(size[1] / 2) * 3)

    def _autocast(self) -> "torch.autocast | nullcontext":
        return torch.autocast(self.device.type, torch.bfloat16) if self.precision == "bfloat16" else nullcontext()

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
        config = self.model.config
        if isinstance(config, ModelConfig) and config.router.vote == "batch":
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

    def _depth_map(self, photo: _Photo, output: DepthOutput) -> DepthMap:
        """Return what the model says of one photo at the photo's own size, on the CPU."""
        domains = self.model.config.domains
        domain = domains[int(output.domain)]
        if output.domain_logits is None:
            probability = {known.name: float(known is domain) for known in domains}
        else:
            softmax = output.domain_logits[0].softmax(dim=0).tolist()
            probability = {known.name: p for known, p in zip(domains, softmax, strict=True)}
        size = _size(photo.image)
        # Bicubic interpolation overshoots at edges, in a near corner to below zero.
        near, far = np.float32(domain.min_depth), np.float32(domain.max_depth)
        depth = _to_array(self._from_network(output.depth, size, mode=self.upsampling)).clip(near, None)
        std = None if output.std is None else _to_array(self._from_network(output.std, size, mode="bilinear"))
        factor = self._focal_factor(photo.camera, domain, photo.network_size)
        if factor != 1:
            near, far = near * np.float32(factor), far * np.float32(factor)
            depth = depth * np.float32(factor)
            std = None if std is None else std * np.float32(factor)
        return DepthMap(
            depth,
            std,
            domain.name,
            probability,
            photo.image,
            photo.network_size,
            photo.camera or self._assumed(size, domain, photo.network_size),
            camera_note=photo.camera_note,
            focal_correction=factor,
            depth_range=(float(near), float(far)),
        )


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


def _size(photo: ImageArray) -> tuple[int, int]:
    return photo.shape[0], photo.shape[1]


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
