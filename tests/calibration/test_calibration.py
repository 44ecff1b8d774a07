"""A calibration: applied and undone, kept in a file, and refused for what it does not hold for."""

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.calibration.rooms import SIZE, read, room

from zoedepth.calibration import Calibration, calibrate, read_calibration, write_calibration
from zoedepth.calibration.calibration import MAX_KEPT
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.stored import to_json

CAMERA = Camera.from_fov(SIZE, horizontal=70, source="exif")


def example() -> Calibration:
    depth, truth = room()
    found = calibrate(depth, [*read(1.3 * truth, 4), ((5, 5), (70, 50), 2.0)], camera=CAMERA, photo="a.jpg")
    return replace(found, network="zoed-lite", domain="indoor")


class TestApply:
    @given(scale=st.floats(0.01, 100), power=st.floats(0.3, 3))
    @settings(max_examples=20)
    def test_undo_takes_it_back(self, scale: float, power: float) -> None:
        depth = np.array([[0.5, 1, 2], [8, 20, 80]], np.float32)
        calibration = Calibration(scale=scale, power=power)
        np.testing.assert_allclose(calibration.undo(calibration.apply(depth)), depth, rtol=1e-5)

    def test_is_scale_times_a_power(self) -> None:
        depth = np.array([[1, 4]], np.float32)
        applied = Calibration(scale=3, power=0.5).apply(depth)
        assert applied.dtype == np.float32
        np.testing.assert_allclose(applied, [[3, 6]], rtol=1e-6)

    @pytest.mark.parametrize("power", [1.0, 0.5])
    def test_what_is_no_depth_stays(self, power: float) -> None:
        depth = np.array([[0, np.nan, np.inf, 4]], np.float32)
        np.testing.assert_array_equal(Calibration(scale=2, power=power).apply(depth)[0, :3], depth[0, :3])

    @pytest.mark.parametrize("power", [1.0, 1.4])
    def test_the_std_is_that_of_the_calibrated_depth(self, power: float) -> None:
        calibration = Calibration(scale=2, power=power)
        depth = np.array([[0.7, 3]], np.float32)
        std = calibration.apply_to_std(np.full((1, 2), 1e-3, np.float32), depth)
        assert std.dtype == np.float32
        slope = (calibration.apply(depth + np.float32(0.01)) - calibration.apply(depth - np.float32(0.01))) / 0.02
        np.testing.assert_allclose(std, 1e-3 * slope, rtol=1e-3)


class TestMismatches:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"network": "zoed-m12-n"}, "model zoed-lite, and this is zoed-m12-n"),
            ({"network": "runs/zoed-lite"}, "model zoed-lite, and this is runs/zoed-lite"),
            ({"domain": "outdoor"}, "head for indoor"),
            ({"focal_corrected": True}, "without the correction"),
            ({"camera": Camera.from_fov(SIZE, horizontal=60)}, "degrees from corner to corner"),
            ({"camera": Camera.from_fov((60, 60), horizontal=70)}, "80 x 60 pixels, and this one 60 x 60"),
            ({"camera": replace(CAMERA, source="assumed")}, "its photo says its camera, and the other does not"),
        ],
    )
    def test_are_named(self, changes: dict[str, Any], message: str) -> None:
        fitting = {"camera": CAMERA, "network": "zoed-lite", "domain": "indoor", "focal_corrected": False}
        (reason,) = example().mismatches(**(fitting | changes))
        assert message in reason

    @pytest.mark.parametrize(
        ("one", "other", "same"),
        [
            ("kitchen", "runs/kitchen", True),
            ("/home/me/runs/kitchen", "runs/kitchen", True),
            ("model.safetensors", "runs/a/model.safetensors", True),
            ("zoedepth-nyu-kitti", "Intel/zoedepth-nyu-kitti", True),
            ("runs/a/model.safetensors", "runs/b/model.safetensors", False),
            ("runs/kitchen", "runs/attic", False),
        ],
    )
    def test_a_model_is_known_by_the_end_of_its_path(self, one: str, other: str, same: bool) -> None:
        for first, second in ((one, other), (other, one)):
            calibration = replace(example(), network=first)
            found = calibration.mismatches(camera=None, network=second, domain=None, focal_corrected=False)
            assert (found == ()) == same

    @pytest.mark.parametrize(
        ("name", "weights", "reason"),
        [
            ("runs/kitchen", "1", None),
            ("runs/kitchen", "2", "other weights of runs/kitchen"),
            ("runs/kitchen", None, None),
            ("copies/other", "1", None),
            ("copies/other", "2", "with the model runs/kitchen, and this is copies/other"),
            ("copies/other", None, "with the model runs/kitchen, and this is copies/other"),
            (None, "2", "other weights of runs/kitchen"),
        ],
    )
    def test_a_model_is_known_by_its_weights_where_both_say_them(
        self, name: str | None, weights: str | None, reason: str | None
    ) -> None:
        calibration = replace(example(), network="runs/kitchen", weights="1")
        found = calibration.mismatches(camera=None, network=name, domain=None, focal_corrected=False, weights=weights)
        assert len(found) == (reason is not None)
        assert (reason or "") in "".join(found)

    @pytest.mark.parametrize(
        "camera",
        [
            CAMERA,
            CAMERA.resized((600, 800)),
            CAMERA.rotated(1),
            CAMERA.mirrored(),
            replace(CAMERA, source="given"),
            None,
        ],
    )
    def test_size_orientation_and_who_said_it_do_not_matter(self, camera: Camera | None) -> None:
        assert example().mismatches(camera=camera, network=None, domain=None, focal_corrected=False) == ()

    def test_two_assumed_cameras_may_be_one(self) -> None:
        assumed = replace(CAMERA, source="assumed")
        calibration = replace(example(), camera=assumed)
        assert calibration.mismatches(camera=assumed, network=None, domain=None, focal_corrected=False) == ()
        (reason,) = calibration.mismatches(camera=CAMERA, network=None, domain=None, focal_corrected=False)
        assert "this photo says its camera" in reason


class TestFiles:
    def test_come_back_equal(self, tmp_path: Path) -> None:
        path = tmp_path / "new" / "camera.json"
        write_calibration(path, example())
        assert read_calibration(path) == example()
        write_calibration(path, replace(example(), scale=2.0))  # its own file is replaced
        assert read_calibration(path).scale == 2

    def test_stay_small(self, tmp_path: Path) -> None:
        depth, truth = room()
        found = calibrate(depth, truth, camera=CAMERA)
        path = tmp_path / "camera.json"
        write_calibration(path, found)
        back = read_calibration(path)
        assert path.stat().st_size < 1 << 16
        assert len(back.readings) <= MAX_KEPT
        assert replace(back, readings=()) == replace(found, readings=())

    def test_keep_some_readings_of_every_photo(self) -> None:
        depth, truth = room()
        found = None
        for number in range(5):
            found = calibrate(depth, truth, camera=CAMERA, photo=f"{number}.jpg", earlier=found)
            found = Calibration.from_json(found.to_json())
        kept = Counter(reading.photo for reading in found.readings)
        assert set(kept) == {f"{number}.jpg" for number in range(5)}
        assert sum(kept.values()) <= MAX_KEPT
        assert min(kept.values()) > MAX_KEPT / 10

    @pytest.mark.parametrize("content", ["hello", "{}", '{"zoedepth": "0.1.0", "source": "a.jpg", "files": {}}'])
    def test_of_others_are_not_replaced(self, tmp_path: Path, content: str) -> None:
        path = tmp_path / "file.json"
        path.write_text(content)
        with pytest.raises(InputError, match="is no calibration and would be replaced"):
            write_calibration(path, example())
        assert path.read_text() == content
        with pytest.raises(InputError, match="is a folder"):
            write_calibration(tmp_path, example())

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"scale": 0}, "the scale of a calibration must be from"),
            ({"scale": -1.5}, "scale"),
            ({"scale": 1e9}, "scale"),
            ({"scale": "2"}, "scale must be float"),
            ({"power": 0}, "power"),
            ({"expected_error": -1}, "expected_error"),
            ({"scale_error": 1e30}, "scale_error"),
            ({"camera": {"size": [60, 80], "fx": 0, "fy": 1, "cx": 1, "cy": 1}}, "focal length"),
            ({"camera": [1]}, "camera"),
            ({"readings": [{"points": [], "metres": 1, "before": 1, "after": 1}]}, "one point or two"),
            ({"readings": [{"points": [[1, 2]], "metres": 0, "before": 1, "after": 1}]}, "metres of the reading 1,2"),
            ({"readings": [{"points": [[1, 2]]}]}, "lacks the fields"),
            ({"zoom": 1}, "unknown fields"),
        ],
    )
    def test_with_nonsense_are_refused(self, tmp_path: Path, changes: dict[str, Any], message: str) -> None:
        path = tmp_path / "camera.json"
        path.write_text(to_json({"zoedepth": "calibration", "calibration": example().to_json() | changes}))
        with pytest.raises(InputError, match=message):
            read_calibration(path)

    @pytest.mark.parametrize(
        "content", ["", "[]", "{}", '{"zoedepth": "calibration"}', "NaN", "[" * 10_000, '{"a": "' + 70_000 * "b" + '"}']
    )
    def test_that_are_none_are_refused(self, tmp_path: Path, content: str) -> None:
        path = tmp_path / "camera.json"
        path.write_text(content)
        with pytest.raises(InputError, match=r"camera\.json"):
            read_calibration(path)

    def test_without_a_scale_are_refused(self) -> None:
        with pytest.raises(InputError, match="scale"):
            Calibration.from_json({})
        with pytest.raises(InputError, match="scale"):
            Calibration.from_json(json.loads('{"scale": null}'))


def test_errors_at_the_readings_are_unknown_without_any() -> None:
    assert math.isnan(Calibration(scale=1.0).error_before)
    assert math.isnan(Calibration(scale=1.0).error_after)


def test_a_link_that_leads_nowhere_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "camera.json").symlink_to(tmp_path / "gone.json")
    with pytest.raises(InputError, match="is no calibration and would be replaced"):
        write_calibration(tmp_path / "camera.json", example())
    assert (tmp_path / "camera.json").is_symlink()
