"""The calibrate command: its options arrive, it says how it went, and predict applies what it kept."""

import copy
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tests.geometry.test_exif import FILM_LENGTH, photo_of

from zoedepth.calibration import Calibration, read_calibration, write_calibration
from zoedepth.cli import main
from zoedepth.depth_map import DepthMap
from zoedepth.lock import only_one
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs.depth import write_depth_png
from zoedepth.predict import Predictor
from zoedepth.stored import read_depth
from zoedepth.weights.save import save_model

PLACES = [(80, 100), (320, 240), (560, 300), (200, 400), (450, 120)]


@pytest.fixture(autouse=True)
def tiny(tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every model name gives the tiny model."""
    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", lambda name, **_: tiny_model)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "photo.jpg"
    photo_of(path, (640, 480), {FILM_LENGTH: 26})
    return path


@pytest.fixture
def depth(photo: Path, tiny_model: ZoeDepth) -> DepthMap:
    """The depth of the photo as the command sees it."""
    return Predictor(tiny_model, flip_average=False)(photo, domain="indoor")


def readings(depth: DepthMap, factor: float, n: int = 5) -> list[str]:
    """Return options with readings that are so many times the depth."""
    return [f"--at={x},{y}={factor * depth.depth[y, x]:.4f}" for x, y in PLACES[:n]]


def calibrate(*arguments: object) -> int:
    return main(
        ["calibrate", *map(str, arguments), *([] if "--undo" in arguments else ["--no-flip", "--domain", "indoor"])]
    )


def test_prints_each_reading_before_and_after_and_the_expected_error(
    photo: Path, depth: DepthMap, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = f"--at=300,50={150 * depth.depth[50, 300]:.4f}"
    assert calibrate(photo, *readings(depth, 1.5), wrong) == 0
    printed = " ".join(capsys.readouterr().out.split())
    x, y = PLACES[0]
    assert f"{x},{y} │ {1.5 * depth.depth[y, x]:.2f} m │ {depth.depth[y, x]:.2f} m │ " in printed
    assert "left out: does not fit" in printed
    assert "in centimetres" in printed
    assert "photo.jpg: 6 readings" in printed
    assert "The readings are off by 33.3% before, and " in printed
    assert "Expected error, in four of five cases: " in printed
    assert "In other photos of this camera" in printed


def test_predict_applies_what_was_kept(photo: Path, depth: DepthMap, tmp_path: Path) -> None:
    kept = tmp_path / "camera.json"
    assert calibrate(photo, *readings(depth, 1.5), "--out", kept) == 0
    calibration = read_calibration(kept)
    assert (calibration.network, calibration.domain, calibration.n_readings) == ("zoed-lite", "indoor", 5)
    assert calibration.camera == depth.camera
    assert calibration.scale == pytest.approx(1.5, rel=0.05)
    options = ["--no-flip", "--domain", "indoor", "--no-preview", "--calibration", str(kept)]
    assert main(["predict", str(photo), "--out", str(tmp_path / "out"), *options]) == 0
    np.testing.assert_allclose(
        read_depth(tmp_path / "out" / "photo_depth.png"), calibration.apply(depth.depth), atol=5.1e-4, rtol=1e-5
    )


def test_prints_the_command_that_predicts_in_the_same_way(
    photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "my camera.json"
    assert calibrate(photo, *readings(depth, 1.5), "--out", kept, "--fov-x", 60, "--pad", "no") == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("Kept in "))
    words = shlex.split(line.split("To use it: ")[1])
    assert words[:5] == ["zoedepth", "predict", "PHOTOS", "--out", "FOLDER"]
    assert words[7:] == ["--no-flip", "--pad", "no", "--domain", "indoor", "--fov-x", "60.0"]
    assert main(["predict", str(photo), "--out", str(tmp_path / "out"), *words[5:]]) == 0


def test_undo_takes_it_out_of_the_files(
    photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, out = tmp_path / "camera.json", tmp_path / "out"
    write_calibration(kept, Calibration(scale=1.5))
    options = ["--no-flip", "--domain", "indoor", "--calibration", str(kept)]
    assert main(["predict", str(photo), "--out", str(out), *options]) == 0
    capsys.readouterr()
    assert calibrate(out, "--undo") == 0
    np.testing.assert_allclose(read_depth(out / "photo_depth.png"), depth.depth, atol=1.1e-3)
    said = capsys.readouterr()
    assert said.out.split() == [str(out / f"photo{ending}") for ending in ("_depth.png", "_preview.jpg", ".json")]
    assert "1 of 1 photos put back" in said.err
    assert calibrate(out, "--undo") == 2
    assert "nothing to undo" in capsys.readouterr().err
    assert calibrate(out / "photo.json", "--undo") == 2


def test_undo_goes_on_after_a_failure(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept, out = tmp_path / "camera.json", tmp_path / "out"
    write_calibration(kept, Calibration(scale=1.5))
    other = tmp_path / "other.jpg"
    other.write_bytes(photo.read_bytes())
    options = ["--no-flip", "--domain", "indoor", "--no-preview", "--calibration", str(kept)]
    assert main(["predict", str(photo), str(other), "--out", str(out), *options]) == 0
    (out / "other_depth.png").unlink()
    assert calibrate(out, "--undo") == 1
    said = capsys.readouterr().err
    assert "other_depth.png is gone" in said
    assert "1 of 2 photos put back" in said


class TestReadings:
    def test_of_a_sparse_depth_map(self, photo: Path, depth: DepthMap, tmp_path: Path) -> None:
        sparse = np.zeros_like(depth.depth)
        sparse[::40, ::40] = 2 * depth.depth[::40, ::40]
        own, bare = tmp_path / "own.png", tmp_path / "bare.png"
        write_depth_png(own, sparse)
        Image.fromarray((sparse * 256).astype(np.uint16)).save(bare)
        assert calibrate(photo, "--depth", own, "--out", tmp_path / "own.json") == 0
        assert calibrate(photo, "--depth", bare, "--depth-scale", 256, "--out", tmp_path / "bare.json") == 0
        scales = [read_calibration(tmp_path / name).scale for name in ("own.json", "bare.json")]
        assert scales == pytest.approx([2, 2], rel=0.02)

    def test_of_a_smaller_map_as_phones_lidars_have_it(self, photo: Path, depth: DepthMap, tmp_path: Path) -> None:
        small = 2 * depth.depth[5::10, 5::10]
        write_depth_png(tmp_path / "lidar.png", small)
        assert calibrate(photo, "--depth", tmp_path / "lidar.png", "--out", tmp_path / "a.json") == 0
        assert read_calibration(tmp_path / "a.json").scale == pytest.approx(2, rel=0.05)

    def test_of_whole_numbers_of_millimetres_in_an_array(self, photo: Path, depth: DepthMap, tmp_path: Path) -> None:
        np.save(tmp_path / "map.npy", (2000 * depth.depth).astype(np.uint16))
        assert calibrate(photo, "--depth", tmp_path / "map.npy") == 2
        options = ["--depth", tmp_path / "map.npy", "--depth-scale", 1000, "--out", tmp_path / "a.json"]
        assert calibrate(photo, *options) == 0
        assert read_calibration(tmp_path / "a.json").scale == pytest.approx(2, rel=0.02)

    def test_of_a_map_that_may_lie_upside_down(
        self, photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        turned = tmp_path / "turned.jpg"
        with Image.open(photo) as picture:
            exif = picture.getexif()
            exif[0x0112] = 3
            picture.save(turned, exif=exif)
        np.save(tmp_path / "map.npy", depth.depth)
        assert calibrate(turned, "--depth", tmp_path / "map.npy") == 2
        assert "turned upright by its EXIF orientation 3, and nothing says whether" in capsys.readouterr().err

    def test_between_two_points(self, photo: Path, depth: DepthMap, tmp_path: Path) -> None:
        metres = 3 * depth.measure((100, 100), (500, 300))
        assert calibrate(photo, f"--between=100,100,500,300={metres}", "--out", tmp_path / "a.json") == 0
        (reading,) = read_calibration(tmp_path / "a.json").readings
        assert reading.before == pytest.approx(metres / 3)
        assert reading.after > 2 * reading.before

    def test_between_needs_a_known_camera(self, photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert calibrate(photo, "--between=100,100,500,300=1", "--camera", "none") == 2
        assert "the distance of two points needs the camera" in capsys.readouterr().err
        assert calibrate(photo, "--between=100,100,500,300=1", "--fov-x", 60) == 0

    def test_along_the_ray_needs_a_known_camera(self, photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert calibrate(photo, "--at=100,100=1", "--along-ray", "--camera", "none") == 2
        assert "a reading along the ray needs the camera" in capsys.readouterr().err

    def test_again_for_one_photo_replaces_its_readings(
        self, photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        kept = tmp_path / "camera.json"
        assert calibrate(photo, "--at=100,100=1", "--out", kept) == 0
        monkeypatch.chdir(photo.parent)
        assert calibrate(photo.name, "--at=200,200=1.5", "--out", kept, "--add") == 0  # by another path
        assert "that" in (said := capsys.readouterr().err)
        assert "are replaced" in said
        assert len(read_calibration(kept).readings) == 1
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / photo.name).write_bytes(photo.read_bytes())
        monkeypatch.chdir(tmp_path / "other")
        assert calibrate(photo.name, "--at=200,200=1.5", "--out", kept, "--add") == 0  # another photo of this name
        assert "are replaced" not in capsys.readouterr().err
        assert len(read_calibration(kept).readings) == 2

    def test_along_the_ray(self, photo: Path, depth: DepthMap, tmp_path: Path) -> None:
        x, y = 600, 40
        assert (
            calibrate(photo, f"--at={x},{y}={depth.distance[y, x]}", "--along-ray", "--out", tmp_path / "a.json") == 0
        )
        assert read_calibration(tmp_path / "a.json").scale == pytest.approx(1, abs=0.01)

    def test_without_any_places_are_proposed(
        self, photo: Path, depth: DepthMap, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert calibrate(photo) == 2
        said = capsys.readouterr().err
        assert "--at X,Y=METRES. Good places in this photo are" in said
        assert said.count("by the model") == 3

    def test_with_a_power(self, photo: Path, depth: DepthMap, capsys: pytest.CaptureFixture[str]) -> None:
        grid = [(x, y) for x in range(60, 640, 130) for y in range(60, 480, 120)]
        options = [f"--at={x},{y}={float(depth.depth[y, x]) ** 1.5}" for x, y in grid]
        assert calibrate(photo, *options, "--form", "scale-shift") == 0
        assert "* depth ** 1." in capsys.readouterr().out
        options = [f"--at={x},{y}={float(depth.depth[y, x]) * 1.2}" for x, y in grid]
        assert calibrate(photo, *options, "--form", "scale-shift") == 0
        assert "No power" in capsys.readouterr().out

    def test_many_are_not_all_shown(self, photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_depth_png(tmp_path / "map.png", np.full((480, 640), 2.0))
        assert calibrate(photo, "--depth", tmp_path / "map.png") == 0
        printed = capsys.readouterr().out
        assert "These are the 20 worst of" in printed
        assert len(printed.splitlines()) < 40


class TestSeveralPhotos:
    def test_add_keeps_the_readings_of_others(
        self, photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        kept = tmp_path / "camera.json"
        assert calibrate(photo, *readings(depth, 1.5, 3), "--out", kept) == 0
        assert "For other photos, add readings of some" in capsys.readouterr().out
        for number in (1, 2):
            other = tmp_path / f"other{number}.jpg"
            other.write_bytes(photo.read_bytes())
            assert calibrate(other, *readings(depth, 1.5, 3), "--out", kept, "--add") == 0
        printed = capsys.readouterr().out
        assert "9 readings in 3 photos" in printed
        assert "other2.jpg 80,100" in printed
        assert "add readings" not in printed.rpartition("9 readings")[2]
        assert (read_calibration(kept).n_photos, read_calibration(kept).n_readings) == (3, 9)
        assert calibrate(photo, *readings(depth, 1.5, 1), "--out", kept) == 0  # without --add
        assert read_calibration(kept).n_readings == 1

    def test_readings_that_another_command_adds_meanwhile_are_kept(
        self, photo: Path, depth: DepthMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        kept, other = tmp_path / "camera.json", tmp_path / "other.jpg"
        other.write_bytes(photo.read_bytes())
        assert calibrate(photo, *readings(depth, 1.5, 3), "--out", kept) == 0
        predict = Predictor.__call__

        def meanwhile(self: Predictor, *arguments: Any, **options: Any) -> DepthMap:
            monkeypatch.setattr(Predictor, "__call__", predict)
            assert calibrate(other, *readings(depth, 1.5, 3), "--out", kept, "--add") == 0
            return predict(self, *arguments, **options)

        third = tmp_path / "third.jpg"
        third.write_bytes(photo.read_bytes())
        monkeypatch.setattr(Predictor, "__call__", meanwhile)
        assert calibrate(third, *readings(depth, 1.5, 3), "--out", kept, "--add") == 0
        assert {Path(each.photo).name for each in read_calibration(kept).readings} == {
            "photo.jpg", "other.jpg", "third.jpg",
        }  # fmt: skip

    def test_two_commands_do_not_write_at_once(
        self, photo: Path, depth: DepthMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:  # fmt: skip
        kept = tmp_path / "camera.json"
        assert calibrate(photo, *readings(depth, 1.5, 3), "--out", kept) == 0
        before = kept.read_bytes()
        monkeypatch.setattr("zoedepth.commands.calibrate._WAIT_S", 0.05)
        with only_one(kept, work="adds", advice=""):
            assert calibrate(photo, *readings(depth, 1.5, 1), "--out", kept, "--add") == 2
        assert "another command adds readings to" in " ".join(capsys.readouterr().err.split())
        assert kept.read_bytes() == before
        assert calibrate(photo, *readings(depth, 1.5, 1), "--out", kept, "--add") == 0

    def test_readings_of_the_service_which_has_no_names_of_photos_are_added_to(
        self, photo: Path, depth: DepthMap, tmp_path: Path
    ) -> None:
        kept = tmp_path / "camera.json"
        assert calibrate(photo, *readings(depth, 1.5, 3), "--out", kept) == 0
        made = read_calibration(kept)
        write_calibration(kept, replace(made, readings=tuple(replace(each, photo="") for each in made.readings)))
        assert calibrate(photo, *readings(depth, 1.5, 2), "--out", kept, "--add") == 0
        assert (read_calibration(kept).n_photos, read_calibration(kept).n_readings) == (2, 5)

    def test_of_two_cameras_are_not_taken_together(
        self, photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        kept = tmp_path / "camera.json"
        assert calibrate(photo, *readings(depth, 1.5, 3), "--out", kept) == 0
        before = kept.read_bytes()
        for changes in ({"weights": "another"}, {"camera": depth.camera.rotated(1).cropped(0, 0, (300, 300))}):
            write_calibration(kept, replace(read_calibration(kept), **changes))
            assert calibrate(photo, *readings(depth, 1.5, 1), "--out", kept, "--add") == 2
            assert "cannot be taken together" in capsys.readouterr().err
            kept.write_bytes(before)


def test_does_not_hold_for_a_model_that_was_trained_again(
    photo: Path, depth: DepthMap, tiny_model: ZoeDepth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, kept = tmp_path / "mine.safetensors", tmp_path / "camera.json"
    save_model(tiny_model, model)
    of_model = ["--model", model, "--out"]
    assert calibrate(photo, *readings(depth, 1.5), *of_model, kept) == 0
    options = ["predict", photo, "--no-flip", "--domain", "indoor", "--calibration", kept, *of_model]
    assert main([*map(str, options), str(tmp_path / "before")]) == 0
    trained = copy.deepcopy(tiny_model)
    with torch.no_grad():
        next(trained.parameters()).add_(1e-3)
    save_model(trained, model)
    assert main([*map(str, options), str(tmp_path / "after")]) == 1
    assert "other weights of" in " ".join(capsys.readouterr().err.split())
    assert calibrate(photo, *readings(depth, 1.5, 1), *of_model, kept, "--add") == 2


def test_says_that_there_is_no_need(photo: Path, depth: DepthMap, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(photo, *readings(depth, 1.0)) == 0
    assert "do not contradict the readings" in capsys.readouterr().out


def test_asks_about_the_unit_where_all_are_far_off(
    photo: Path, depth: DepthMap, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(photo, *readings(depth, 100)) == 0
    assert "are the readings in metres?" in capsys.readouterr().out


def test_json_is_the_calibration_alone(
    photo: Path, depth: DepthMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(photo, *readings(depth, 1.5), "--json", "--out", tmp_path / "a.json") == 0
    assert Calibration.from_json(json.loads(capsys.readouterr().out)) == read_calibration(tmp_path / "a.json")
    assert calibrate(photo, *readings(depth, 250), "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["scale"] == pytest.approx(250, rel=0.05)
    assert "are the readings in metres?" in printed.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--at", "320,240"], "'320,240' is no reading"),
        (["--at", "320=2"], "is no reading"),
        (["--at", "a,b=2"], "is no reading"),
        (["--at", "320,240=2,35"], "is no reading"),
        (["--between", "320,240=2"], "give --between X,Y,X,Y=METRES"),
        (["--at", "640,240=2"], "outside of the photo"),
        (["--at", "320,240=0"], "above 0"),
        (["--at", "320,240=nan"], "above 0"),
        (["--at", "320,240=2", "--depth", "photo.jpg"], "not both"),
        (["--at", "320,240=2", "--depth-scale", "1000"], "--depth-scale is for --depth"),
        (["--depth", "a.png", "--depth-scale", "0.001"], "1000 for millimetres, also where a sensor says 0.001"),
        (["--depth", "gone.png"], "gone.png"),
        (["--at", "320,240=2", "--out", "."], "is a folder"),
        (["--at", "320,240=2", "--out", "photo.jpg"], "is no calibration and would be replaced"),
        (["--at", "320,240=2", "--add"], "--add adds to the readings"),
        (["--at", "320,240=2", "--add", "--out", "gone.json"], "gone.json"),
        (["--at", "320,240=2", "--undo"], "leave out"),
    ],
)
def test_a_wrong_option_is_said(
    photo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    monkeypatch.chdir(photo.parent)
    content = photo.read_bytes()
    assert calibrate("photo.jpg", *options) == 2
    assert message in capsys.readouterr().err
    assert photo.read_bytes() == content
    assert [file.name for file in photo.parent.iterdir()] == ["photo.jpg"]


def test_a_model_without_metres_is_refused(
    photo: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = ZoeDepth(replace(tiny_model.config, domains=())).eval()
    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", lambda name, **_: bare)
    assert main(["calibrate", str(photo), "--at", "320,240=2"]) == 2
    assert "no metres to calibrate" in capsys.readouterr().err
