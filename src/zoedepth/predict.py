"""From a photo to metres: everything around the model, which itself sees only pixels of the network size."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from zoedepth.config import Domain
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.forward.answer import Answer, Precision
from zoedepth.forward.arrays import ArrayForward
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.choice import CameraChoice, CameraChoices, check_choice, choice_for_each, known_without_notes
from zoedepth.geometry.exif import read_exif_camera
from zoedepth.images import DepthArray, ImageArray, to_image, to_image_with_notes
from zoedepth.sizes import border, network_focal, network_size
from zoedepth.weights.exported import ExportedModel

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float, Int
    from torch import Tensor

    from zoedepth.forward.tensors import TensorForward
    from zoedepth.model.interface import DepthModel

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
        model: a model in evaluation mode. An exported one is run without importing torch.
        flip_average: predict the mirrored photo too and average. It takes twice the work, gives smoother edges, and the
            mirrored photo gives the mirrored depth.
        pad: reflect the photo's borders outwards before the network and cut them off after, against border artefacts.
            None does what the model's config says.
        upsampling: how the depth is resized to the photo's size: "bicubic" as in the original's ``infer``, or
            "bilinear" (corners aligned) as in its evaluation.
        resize: "keep-aspect" or "squeeze" the photo, see ``ModelConfig.resize``. None does what the config says.
        device: where to run, "auto" for the best there is. None stays where the model is.
        precision: "bfloat16", or on a GPU "float16" (not run), runs a model of torch under autocast; the output is
            float32 either way. An exported model has the precision that it was loaded with. ``load_fast`` in
            ``zoedepth.runtimes.fast`` takes what is fastest on this machine.
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
        InputError: unknown precision, device or camera; float16 without a GPU; or ``focal_correction`` is True, and the
            model's config does not say the focal length of its training photos (``Domain.focal_px``).
    """

    def __init__(
        self,
        model: "DepthModel | ExportedModel",
        *,
        flip_average: bool = True,
        pad: bool | None = None,
        upsampling: Literal["bicubic", "bilinear"] = "bicubic",
        resize: Literal["keep-aspect", "squeeze"] | None = None,
        device: "str | torch.device | None" = None,
        precision: Precision = "float32",
        camera: CameraChoice = "exif",
        focal_correction: bool | None = None,
    ) -> None:
        if upsampling not in ("bicubic", "bilinear"):
            raise InputError(f"upsampling must be 'bicubic' or 'bilinear', got {upsampling!r}")
        if resize not in (None, "keep-aspect", "squeeze"):
            raise InputError(f"resize must be 'keep-aspect', 'squeeze' or None, got {resize!r}")
        if precision not in ("float32", "bfloat16", "float16"):
            raise InputError(f"precision must be 'float32', 'bfloat16' or 'float16', got {precision!r}")
        check_choice(camera)
        if focal_correction and camera == "none":
            raise InputError(
                "camera='none' (--camera none) names no focal length to correct depth by: leave one of them out"
            )
        unknown = [domain.name for domain in model.config.domains if domain.focal_px is None]
        if focal_correction and unknown:
            raise InputError(
                f"the config of this model does not say with what focal length it was trained for {', '.join(unknown)} "
                "(Domain.focal_px), so that depth cannot be corrected by the focal length of the photo: leave "
                "focal_correction out (--focal-correction)"
            )
        if not isinstance(model, ExportedModel):
            from zoedepth.forward.tensors import on_device

            model = on_device(model, device)
        elif device is not None and str(device) not in ("auto", "cpu"):
            raise InputError(f"an exported model cannot be moved to {str(device)!r}: leave the device out")
        if precision == "float16" and (isinstance(model, ExportedModel) or model.device.type == "cpu"):
            raise InputError("float16 is for models of torch on a GPU: take float32 or bfloat16")
        self.model = model
        self.flip_average = flip_average
        self.pad = model.config.pad if pad is None else pad
        self.upsampling: Literal["bicubic", "bilinear"] = upsampling
        self.keep_aspect_ratio = model.config.keep_aspect_ratio and resize != "squeeze"
        if resize == "keep-aspect" and not model.config.one_size:
            self.keep_aspect_ratio = True
        self.precision: Precision = precision
        self.camera: CameraChoice = camera
        self.focal_correction = focal_correction

    @property
    def device(self) -> "torch.device":
        """The device on which the model is."""
        return self.model.device

    @property
    def runtime(self) -> str:
        """The library that computes, and in which numbers: "torch, float32", "OpenVINO, int8"."""
        if isinstance(self.model, ExportedModel):
            return f"{self.model.runtime}, {self.model.precision}"
        return f"torch, {self.precision}"

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
        if isinstance(images, str | bytes | Path):
            raise InputError(f"batch takes a list of photos, got {type(images).__name__}: put one photo into brackets")
        if batch_size < 1:
            raise InputError(f"batch_size must be 1 or more, got {batch_size}")
        head = None if domain is None else self.domain_index(domain)
        cameras = choice_for_each(camera, len(images))
        photos = [self._photo(image, choice) for image, choice in zip(images, cameras, strict=True)]
        return self._predict(photos, head, batch_size=batch_size)

    def parts(self, images: Sequence[ImageArray], cameras: Sequence[Camera], *, domain: str) -> list[DepthMap]:
        """Predict parts of one photo, as ``batch`` does, but that nothing is said of parts in which nothing shows: sky.

        Args:
            images: parts of the photo, of any sizes.
            cameras: the camera of each part.
            domain: scene type whose head to use for all of them.

        Raises:
            InputError: the domain is unknown, a part is too long and narrow, or the model is in training mode.
        """
        head = self.domain_index(domain)
        photos = [
            _Photo(image, self.network_size(_size(image)), camera, "")
            for image, camera in zip(images, cameras, strict=True)
        ]
        return self._predict(photos, head, batch_size=len(photos))

    def infer(
        self,
        pixels: "Float[Tensor, 'batch 3 height width']",
        *,
        domain: "Int[Tensor, ' batch'] | None" = None,
        camera: CameraChoices = None,
    ) -> "Float[Tensor, 'batch 1 height width']":
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
        from zoedepth.pixels import check_pixels

        check_pixels(pixels)
        size = (pixels.shape[2], pixels.shape[3])
        network_size = self.network_size(size)
        choices: list[CameraChoice] = [
            self.camera if each is None else each for each in choice_for_each(camera, len(pixels))
        ]
        cameras = [known_without_notes(choice, size) for choice in choices]
        depth, taken = self._tensor_forward.infer(pixels, network_size, domain)
        if all(known is None for known in cameras):
            return depth
        heads = [self.model.config.domains[head] for head in taken]
        factors = [self._focal_factor(*each, network_size) for each in zip(cameras, heads, strict=True)]
        return depth * depth.new_tensor(factors)[:, None, None, None]

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
        photo = to_image(image)
        return self._forward.relative(photo, self.network_size(_size(photo)))

    def network_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the (height, width) at which the model sees a photo of ``size`` (height, width).

        Raises:
            InputError: the photo is so long and narrow that the model would exhaust the memory.
        """
        config = self.model.config
        rows, columns = border(size) if self.pad else (0, 0)
        padded = (size[0] + 2 * rows, size[1] + 2 * columns)
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

    def _predict(self, photos: Sequence[_Photo], head: int | None, *, batch_size: int) -> list[DepthMap]:
        answers = self._forward.predict(
            [(photo.image, photo.network_size) for photo in photos], head, batch_size=batch_size
        )
        return [self._depth_map(photo, answer) for photo, answer in zip(photos, answers, strict=True)]

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
        height = camera.size[0] + (2 * border(camera.size)[0] if self.pad else 0)
        return network_focal(camera.fy, height, network_size[0])

    @property
    def _forward(self) -> "ArrayForward | TensorForward":
        """The forward of the model: without torch where it can do without."""
        if isinstance(self.model, ExportedModel):
            return ArrayForward(self.model, self.pad, self.flip_average, self.upsampling)
        return self._tensor_forward

    @property
    def _tensor_forward(self) -> "TensorForward":
        from zoedepth.forward.tensors import TensorForward

        return TensorForward(self.model, self.pad, self.flip_average, self.upsampling, self.precision)

    def _depth_map(self, photo: _Photo, answer: Answer) -> DepthMap:
        """Return what the model says of one photo, in metres of the photo's camera."""
        domains = self.model.config.domains
        domain = domains[answer.domain]
        odds = answer.probability or [float(known is domain) for known in domains]
        probability = {known.name: p for known, p in zip(domains, odds, strict=True)}
        # Bicubic interpolation overshoots at edges, in a near corner to below zero.
        near, far = np.float32(domain.min_depth), np.float32(domain.max_depth)
        depth = answer.depth.clip(near, None)
        factor = self._focal_factor(photo.camera, domain, photo.network_size)
        if factor != 1:
            near, far = near * np.float32(factor), far * np.float32(factor)
            depth = depth * np.float32(factor)
        std = None if answer.std is None else answer.std * np.float32(factor * domain.std_factor)
        return DepthMap(
            depth,
            std,
            domain.name,
            probability,
            photo.image,
            photo.network_size,
            photo.camera or self._assumed(_size(photo.image), domain, photo.network_size),
            camera_note=photo.camera_note,
            focal_correction=factor,
            depth_range=(float(near), float(far)),
        )


def _size(photo: ImageArray) -> tuple[int, int]:
    return photo.shape[0], photo.shape[1]
