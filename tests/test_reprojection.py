"""A rendered room, from its photo to points in space, and back into another camera: right to half a pixel.

The photo's brightness is the true depth, and the model gives it back: padding, resizing, mirroring and turning upright
happen to the depth as they happen to the photo, so that it comes out where the network's would.
"""

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor, nn

from zoedepth.config import Domain, RouterConfig
from zoedepth.depth_map import DepthMap
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.model.interface import DepthModel, DepthOutput
from zoedepth.predict import Predictor

SIZE = (120, 160)
CAMERA = Camera.from_focal(110.0, SIZE)
ROOM = (0.9, 0.7, 2.0)
"""Metres from the camera to the walls at its sides, to floor and ceiling, and to the wall in front."""
BASELINE = np.array([0.15, 0.05, -0.1])
"""Metres from the camera to another one, which looks the same way."""
CANONICAL_PX = 75.0

# EXIF orientation -> what an upright picture is done to be stored so.
STORED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda x: x,
    2: lambda x: x[:, ::-1],
    3: lambda x: x[::-1, ::-1],
    4: lambda x: x[::-1],
    5: lambda x: x.swapaxes(0, 1),
    6: lambda x: np.rot90(x),
    7: lambda x: np.rot90(x, 2).swapaxes(0, 1),
    8: lambda x: np.rot90(x, -1),
}


class Copying(DepthModel):
    """The depth is the red channel, in metres: 0.5 for black, 2.5 for white; in a canonical camera, what that sees."""

    def __init__(self, *, pad: bool = False, antialias: bool = False, true_focal_px: float | None = None) -> None:
        nn.Module.__init__(self)
        self.config = SimpleNamespace(
            size=(96, 128),
            multiple=32,
            one_size=False,
            keep_aspect_ratio=True,
            antialias=antialias,
            pad=pad,
            domains=(Domain("indoor", focal_px=CANONICAL_PX),),
            router=RouterConfig(),
            canonical_camera=true_focal_px is not None,
        )
        self.scale = 1.0 if true_focal_px is None else CANONICAL_PX / true_focal_px
        self.weight = nn.Parameter(torch.ones(1))
        self.eval()

    def forward(self, pixels: Tensor, *, domain: Tensor | None = None, **options: bool) -> DepthOutput:
        depth = (0.5 + 2 * pixels[:, :1]) * self.scale
        return DepthOutput(depth, None, torch.zeros(len(pixels), dtype=torch.long), None, None, None, None)


def room_points(camera: Camera) -> np.ndarray:
    """Return the point of the room that each pixel sees, by where its ray meets the first wall."""
    rays = camera.rays().astype(np.float64)
    with np.errstate(divide="ignore"):
        depth = np.minimum.reduce([ROOM[i] / abs(rays[..., i]) for i in range(3)])
    return rays * depth[..., None]


def photo_of(points: np.ndarray) -> np.ndarray:
    """Return a photo of the room whose brightness is the depth, in 8 bits."""
    grey = np.rint((points[..., 2] - 0.5) / 2 * 255).astype(np.uint8)
    assert grey.min() > 0
    assert grey.max() < 255
    return np.repeat(grey[..., None], 3, axis=-1)


def assert_lands(result: DepthMap, camera: Camera) -> None:
    """Points land within half a pixel of where the true ones do, in the photo's true camera and in another one."""
    true = room_points(camera)
    valid = result.valid
    assert valid.mean() > 0.95
    for shift in (np.zeros(3), BASELINE):
        errors = camera.project(result.points + shift) - camera.project(true + shift)
        assert np.linalg.norm(errors, axis=-1)[valid].max() < 0.5
    assert result.camera.source != "assumed"


def save_with_notes(path: Path, photo: np.ndarray, tags: dict[int, object]) -> Path:
    exif = Image.Exif()
    exif[0x0112] = tags.pop(0x0112, 1)
    exif.get_ifd(0x8769).update(tags)
    Image.fromarray(np.ascontiguousarray(photo)).save(path, exif=exif)
    return path


FILM_FOCAL, FILM_DIAGONAL = 0xA405, math.hypot(36, 24)
TRUTH_FROM_EXIF = Camera.from_focal(24 / FILM_DIAGONAL * math.hypot(*SIZE), SIZE)
"""The camera of a photo whose focal length is that of 24 mm on 35-mm film."""


@pytest.mark.parametrize("orientation", STORED)
def test_by_exif_in_each_orientation(orientation: int, tmp_path: Path) -> None:
    upright = photo_of(room_points(TRUTH_FROM_EXIF))
    path = save_with_notes(tmp_path / "photo.png", STORED[orientation](upright), {FILM_FOCAL: 24, 0x0112: orientation})
    result = Predictor(Copying())(path)
    np.testing.assert_array_equal(result.image, upright)
    assert result.camera.source == "exif"
    assert_lands(result, TRUTH_FROM_EXIF)


@pytest.mark.parametrize(
    "known",
    [
        CAMERA,
        CAMERA.intrinsics,
        CAMERA.resized((360, 480)),
        Lens(fov_x=CAMERA.fov_x),
        Lens(fov_y=CAMERA.fov_y),
        Lens(focal_px=110.0),
        Lens(fov_diagonal=2 * math.degrees(math.atan(math.hypot(*SIZE) / 2 / 110))),
    ],
    ids=["camera", "intrinsics", "camera of the large photo", "fov x", "fov y", "focal length", "diagonal"],
)
def test_by_a_camera_that_is_given(known: Camera | Intrinsics | Lens) -> None:
    photo = photo_of(room_points(CAMERA))
    assert_lands(Predictor(Copying(), camera=known, focal_correction=False)(photo), CAMERA)


CROPPED = CAMERA.cropped(11, 30, (96, 110))


@pytest.mark.parametrize("pad", [False, True], ids=["whole", "padded"])
@pytest.mark.parametrize("flip", [False, True], ids=["once", "mirror averaged"])
@pytest.mark.parametrize("antialias", [False, True], ids=["corners aligned", "filtered"])
@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        CROPPED,
        CAMERA.resized((150, 175)),
        CROPPED.mirrored(),
        CROPPED.rotated(1),
        CROPPED.padded(9, 4, (118, 120)),
    ],
    ids=["whole", "cropped", "resized", "mirrored", "turned", "padded"],
)
def test_through_whatever_was_done_to_the_photo(camera: Camera, pad: bool, flip: bool, antialias: bool) -> None:
    """The photo is that of the changed camera, whose principal point is somewhere else; the room is the same."""
    photo = photo_of(room_points(camera))
    predictor = Predictor(Copying(pad=pad, antialias=antialias), flip_average=flip, focal_correction=False)
    result = predictor(photo, camera=camera)
    assert result.camera == camera
    assert_lands(result, camera)


@pytest.mark.parametrize(("pad", "rows"), [(False, 120), (True, 120 + 2 * 23)])
@pytest.mark.parametrize("fov", [60.0, 85.0])
def test_depth_of_a_canonical_camera_becomes_that_of_the_photo_s(fov: float, pad: bool, rows: int) -> None:
    """The network sees the photo at 96 rows, of which padding, 3 sqrt(side / 2), takes its part."""
    camera = Lens(fov_x=fov).camera(SIZE)
    seen_focal_px = camera.fy * 96 / rows
    result = Predictor(Copying(pad=pad, true_focal_px=seen_focal_px))(photo_of(room_points(camera)), camera=camera)
    assert result.focal_correction == pytest.approx(seen_focal_px / CANONICAL_PX)
    assert_lands(result, camera)
