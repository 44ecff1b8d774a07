"""Whom to ask for the camera: one for all photos or one for each, and what is no answer."""

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.choice import check_choice, choice_for_each, known_without_notes
from zoedepth.geometry.lens import Lens

CAMERA = Camera.from_focal(500.0, (480, 640))


@pytest.mark.parametrize("choice", [CAMERA, CAMERA.intrinsics, Lens(fov_x=70), "exif", "none"], ids=str)
def test_one_for_all(choice: object) -> None:
    check_choice(choice)
    assert choice_for_each(choice, 3) == [choice] * 3
    assert choice_for_each(None, 2) == [None, None]


def test_one_for_each() -> None:
    choices = (CAMERA, None, "exif")
    assert list(choice_for_each(choices, 3)) == list(choices)
    for n_photos in (2, 4):
        with pytest.raises(InputError, match=f"{n_photos} photos and 3 cameras"):
            choice_for_each(choices, n_photos)


@pytest.mark.parametrize("wrong", ["Exif", "", 70, np.eye(3), object(), None], ids=lambda value: type(value).__name__)
def test_what_is_none_is_refused(wrong: object, unchecked_types: None) -> None:
    with pytest.raises(InputError, match="camera must be a Camera, Intrinsics, a Lens, 'exif' or 'none', got"):
        check_choice(wrong)
    with pytest.raises(InputError, match="camera must be"):
        known_without_notes(wrong, (480, 640))


def test_without_notes_there_is_the_camera_that_is_given_or_none() -> None:
    assert known_without_notes(CAMERA, (480, 640)) is CAMERA
    assert known_without_notes(CAMERA, (240, 320)) == CAMERA.resized((240, 320))
    assert known_without_notes(Intrinsics(500.0, 501.0, 3.0, 4.0), (9, 9)) == Camera((9, 9), 500.0, 501.0, 3.0, 4.0)
    assert known_without_notes(Lens(focal_px=500.0), (480, 640)) == CAMERA
    assert known_without_notes("exif", (480, 640)) is None
    assert known_without_notes("none", (480, 640)) is None
