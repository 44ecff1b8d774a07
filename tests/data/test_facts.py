"""Facts beside the photos: which keys are read, what goes before what, and values that cannot be."""

from pathlib import Path

import pytest

from zoedepth.data.facts import Facts, camera_of_photo, parse_facts, read_defaults
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens

CAMERA = Intrinsics(5, 6, 7, 8)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({}, Facts()),
        ({"depth_scale": "", "domain": None, "fx": "", "cam_in": None, "other": object()}, Facts()),
        ({"depth_scale": "1000", "domain": "indoor"}, Facts(1000, "indoor")),
        ({"fx": 5, "fy": "6.0", "cx": 7, "cy": 8, "cam_in": [1, 1, 1, 1]}, Facts(camera=CAMERA)),
        ({"cam_in": [5, 6, 7, 8]}, Facts(camera=CAMERA)),
        ({"max_depth": "65.53"}, Facts(max_depth=65.53)),
    ],
)
def test_keys_of_a_row(row: dict, expected: Facts) -> None:
    assert parse_facts(row, "here") == expected


@pytest.mark.parametrize(
    ("row", "word"),
    [
        ({"depth_scale": "mm"}, "depth_scale must be a number.*'mm'"),
        ({"depth_scale": True}, "depth_scale must be a number.*True"),
        ({"depth_scale": 0}, "depth_scale must be finite and > 0; it is 0"),
        ({"depth_scale": "inf"}, "depth_scale must be finite"),
        ({"domain": 3}, "domain must be text.*3"),
        ({"max_depth": "sky"}, "max_depth must be a number > 0.*'sky'"),
        ({"max_depth": -1}, "max_depth must be a number > 0.*-1"),
        ({"fx": 5}, r"four numbers.*\[5, None, None, None\]"),
        ({"fx": 5, "fy": 6, "cx": 7, "cy": "nan"}, "four numbers"),
        ({"fx": 0, "fy": 6, "cx": 7, "cy": 8}, "focal lengths.*0.0 and 6.0"),
        ({"cam_in": [5, 6, 7]}, r"cam_in must be the list \[fx, fy, cx, cy\].*\[5, 6, 7\]"),
        ({"depth_scale": ["x" * 1000]}, "…$"),
    ],
)
def test_value_that_cannot_be_is_an_error_that_names_place_and_key(row: dict, word: str) -> None:
    with pytest.raises(InputError, match=f"^here: .*{word}"):
        parse_facts(row, "here")


def test_facts_go_before_defaults_one_by_one() -> None:
    defaults = Facts(256, "outdoor", CAMERA, 80)
    assert Facts().over(defaults) == defaults
    assert Facts(1000).over(defaults) == Facts(1000, "outdoor", CAMERA, 80)
    assert Facts(None, "indoor", max_depth=10).over(defaults) == Facts(256, "indoor", CAMERA, 10)
    assert defaults.over(Facts(1, "attic", Intrinsics(1, 1, 1, 1), 1)) == defaults


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_scale_that_cannot_be_is_an_error(scale: float) -> None:
    with pytest.raises(InputError, match="depth_scale must be finite and > 0"):
        Facts(scale)
    with pytest.raises(InputError, match="max_depth must be finite and > 0"):
        Facts(max_depth=scale)


def test_defaults_are_in_a_file_of_the_folder_or_there_are_none(tmp_path: Path) -> None:
    assert read_defaults(tmp_path) == Facts()
    (tmp_path / "dataset.json").write_text('{"domain": "indoor", "cam_in": [5, 6, 7, 8]}')
    assert read_defaults(tmp_path) == Facts(None, "indoor", CAMERA)
    (tmp_path / "dataset.json").write_text(" " * 2_000_000)
    with pytest.raises(InputError, match=r"dataset\.json is longer than"):
        read_defaults(tmp_path)


def test_a_lens_becomes_the_camera_of_its_photo_if_it_can_be_one() -> None:
    assert camera_of_photo(None, (30, 40)) is None
    assert camera_of_photo(CAMERA, (30, 40)) == CAMERA
    assert camera_of_photo(Lens(focal_px=25), (30, 40)) == Intrinsics(25, 25, 19.5, 14.5)
    assert camera_of_photo(Lens(focal_px=518.8579), (480, 640)) == Intrinsics(518.8579, 518.8579, 319.5, 239.5)
    for number in (1, 50, 1e5):  # none, millimetres, a wrong unit
        assert camera_of_photo(Lens(focal_px=number), (480, 640)) is None
