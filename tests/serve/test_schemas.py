import json

import pytest
from pydantic import ValidationError

from zoedepth.calibration import Calibration
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.outputs import Options
from zoedepth.serve.engine import Wanted
from zoedepth.serve.problems import Problem
from zoedepth.serve.schemas import LISTS, MAX_POINTS, CalibratedQuery, DepthQuery, PredictionQuery, parse_list


def query(**values: object) -> DepthQuery:
    return DepthQuery.model_validate(values)


def test_defaults_are_those_of_the_command_line() -> None:
    assert query().wanted() == Wanted()
    assert query().options() == Options()


@pytest.mark.parametrize(
    ("given", "camera"),
    [
        ({}, "exif"),
        ({"camera": "none"}, "none"),
        ({"fov_x": 60}, Lens(fov_x=60)),
        ({"fov_y": 60}, Lens(fov_y=60)),
        ({"fov_diagonal": 60}, Lens(fov_diagonal=60)),
        ({"focal_px": 500}, Lens(focal_px=500)),
        ({"intrinsics": "500,501.5,320,-2"}, Intrinsics(500, 501.5, 320, -2)),
    ],
)
def test_one_camera_can_be_said(given: dict, camera: object) -> None:
    assert query(**given).wanted().camera == camera


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"camera": "exif", "fov_x": 60}, "camera and fov_x each say the camera"),
        ({"fov_x": 60, "fov_y": 60}, "fov_x and fov_y each say the camera"),
        ({"intrinsics": "0,500,1,1"}, "focal lengths of intrinsics must be above 0"),
    ],
)
def test_several_cameras_or_none_at_all_are_refused(given: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        query(**given).wanted()


@pytest.mark.parametrize(
    "given",
    [{"fov_x": 0}, {"fov_x": 5e-324}, {"fov_x": 180}, {"fov_x": "inf"}, {"intrinsics": "1,2,3,4,5"},
     {"intrinsics": "1e9,1,1,1"}, {"camera": "/etc/passwd"}, {"unknown": 1}, {"flip": "1"}],
)  # fmt: skip
def test_values_that_nothing_can_have_are_invalid(given: dict) -> None:
    with pytest.raises(ValidationError) as caught:
        query(**given)
    assert [error["loc"] for error in caught.value.errors()] == [tuple(given)]


def test_the_smallest_and_widest_lens_make_a_camera() -> None:
    for name in ("fov_x", "fov_y", "fov_diagonal"):
        for degrees in (2.8, 160):
            camera = query(**{name: degrees}).wanted().camera
            assert isinstance(camera, Lens)
            assert camera.camera((48, 64)).focal_px > 0


def test_a_calibration_is_a_part_or_a_factor_and_not_both() -> None:
    part = json.dumps({"zoedepth": "calibration", "calibration": Calibration(1.5).to_json()}).encode()
    assert CalibratedQuery.model_validate({}).calibration(None) is None
    assert CalibratedQuery.model_validate({}).calibration(part) == Calibration(1.5)
    factor = CalibratedQuery.model_validate({"calibration_scale": "2"})
    assert factor.calibration(None) == Calibration(2)
    with pytest.raises(InputError, match="one of them"):
        factor.calibration(part)
    with pytest.raises(InputError, match="long"):
        CalibratedQuery.model_validate({}).calibration(b" " * 1_100_000)


@pytest.mark.parametrize(
    ("name", "content", "values"),
    [
        ("points", b"[[1, 2.5]]", [(1, 2.5)]),
        ("pairs", b"[[[1, 2], [3, 4]]]", [((1, 2), (3, 4))]),
        ("readings", b"[[1, 2, 3.5]]", [(1, 2, 3.5)]),
        ("distances", b"[[[1, 2], [3, 4], 0.5]]", [((1, 2), (3, 4), 0.5)]),
        ("points", None, []),
        ("points", b"[]", []),
    ],
)
def test_lists_are_read(name: str, content: bytes | None, values: list) -> None:
    assert parse_list(name, content) == values


@pytest.mark.parametrize("name", LISTS)
@pytest.mark.parametrize("content", [b"", b"{}", b"[[]]", b"[1]", b'[["a", "b"]]', b"[[1, 2, 3, 4]]", b"[[1e99, 1, 1]]",
                                     b"[[1, 2, -1]]" , b"[" + b"[1,2]," * MAX_POINTS + b"[1,2]]", b"\xff"])  # fmt: skip
def test_what_is_no_such_list_is_told_with_how_it_is_written(name: str, content: bytes) -> None:
    with pytest.raises(Problem, match=name) as caught:
        parse_list(name, content)
    assert caught.value.kind == "invalid-request"
    assert LISTS[name][1] in caught.value.detail


def test_every_field_says_what_it_is() -> None:
    assert all(field.description for field in DepthQuery.model_fields.values())
    assert all(field.description for field in PredictionQuery.model_fields.values())
