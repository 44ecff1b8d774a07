"""The options that say the camera, for all commands that predict photos."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.commands.cameras import chosen_camera
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.choice import known_without_notes
from zoedepth.geometry.lens import Lens

NOTHING = {
    "camera": None, "fov_x": None, "fov_y": None, "fov_diagonal": None, "focal_px": None, "intrinsics": None
}  # fmt: skip


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    """A broken photo, one that its notes turn to 60 x 40 pixels, and one of another size."""
    (tmp_path / "0.jpg").write_bytes(b"no picture")
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((60, 40, 3), np.uint8)).save(tmp_path / "1.jpg", exif=exif)
    Image.fromarray(np.zeros((30, 30, 3), np.uint8)).save(tmp_path / "2.jpg")
    return [tmp_path / f"{index}.jpg" for index in range(3)]


def test_what_needs_no_photo_reads_none() -> None:
    for options, expected in (
        ({}, "exif"),
        ({"camera": "exif"}, "exif"),
        ({"camera": "none"}, "none"),
        ({"fov_x": 70.0}, Lens(fov_x=70)),
        ({"fov_y": 50.0}, Lens(fov_y=50)),
        ({"fov_diagonal": 80.0}, Lens(fov_diagonal=80)),
    ):
        assert chosen_camera([Path("missing.jpg")], **{**NOTHING, **options}) == expected


def test_pixels_are_those_of_the_first_photo_that_can_be_read(photos: list[Path]) -> None:
    found = chosen_camera(photos, **{**NOTHING, "focal_px": 55.0})
    assert found == Camera.from_focal(55.0, (40, 60))
    found = chosen_camera(photos, **{**NOTHING, "intrinsics": (55.0, 56.0, 28.0, 21.0)})
    assert found == Camera((40, 60), 55.0, 56.0, 28.0, 21.0)
    with pytest.raises(InputError, match=r"0\.jpg"):
        chosen_camera(photos[:1], **{**NOTHING, "focal_px": 55.0})

    def damaged() -> Path:
        raise InputError("a.zip::0.jpg: cannot be read from its archive")

    found = chosen_camera([damaged, lambda: photos[1]], **{**NOTHING, "focal_px": 55.0})
    assert found == Camera.from_focal(55.0, (40, 60))
    with pytest.raises(InputError, match=r"a\.zip::0\.jpg"):
        chosen_camera([damaged], **{**NOTHING, "focal_px": 55.0})


def test_a_file_serves_the_photos_it_suits_whatever_the_size_of_the_first(photos: list[Path], tmp_path: Path) -> None:
    (tmp_path / "k.json").write_text('{"width": 60, "height": 60, "fx": 55, "fy": 56, "cx": 29, "cy": 30}')
    found = chosen_camera(photos, **{**NOTHING, "camera": str(tmp_path / "k.json")})
    with pytest.raises(InputError, match="of other proportions"):
        known_without_notes(found, (40, 60))
    camera = known_without_notes(found, (30, 30))
    assert camera is not None
    assert camera.fx == pytest.approx(27.5)


def test_a_file(photos: list[Path], tmp_path: Path) -> None:
    np.save(tmp_path / "k.npy", np.array([[55.0, 0, 28], [0, 56, 21], [0, 0, 1]]))
    found = chosen_camera(photos, **{**NOTHING, "camera": str(tmp_path / "k.npy")})
    assert found == Camera((40, 60), 55.0, 56.0, 28.0, 21.0)
    with pytest.raises(InputError, match=r"--camera must be exif, none or a file.*'Exit'"):
        chosen_camera(photos, **{**NOTHING, "camera": "Exit"})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": "exif", "fov_x": 70.0}, "--camera and --fov-x each say the camera: give one"),
        ({"focal_px": 55.0, "fov_y": 50.0, "fov_x": 70.0}, "--fov-x and --fov-y and --focal-px"),
        ({"fov_x": 0.0}, "between 0 and 180"),
        ({"fov_diagonal": float("nan")}, "between 0 and 180"),
        ({"focal_px": 0.0}, "focal length fx must be above 0"),
        ({"focal_px": float("inf")}, "focal length fx must be above 0"),
        ({"intrinsics": (55.0, -1.0, 28.0, 21.0)}, "focal length fy must be above 0"),
        ({"intrinsics": (55.0, 56.0, float("nan"), 21.0)}, "cx must be a finite number"),
        (
            {"intrinsics": (110.0, 110.0, 59.5, 39.5)},
            r"\(59\.5, 39\.5\), is far from the middle of a photo of 60 x 40 pixels",
        ),
    ],
)
def test_what_is_no_camera_is_refused(photos: list[Path], options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        chosen_camera(photos, **{**NOTHING, **options})
