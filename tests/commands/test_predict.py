"""The predict command: its options arrive, and it says how it went. ``tests/test_batch.py`` tests the work itself."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_photo

from zoedepth.batch import Request
from zoedepth.calibration import Calibration, write_calibration
from zoedepth.cli import main
from zoedepth.depth_map import DepthMap
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.jobs.work import Done, Input, do_photo
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import OUTPUTS
from zoedepth.predict import Predictor
from zoedepth.runtimes.fast import Fast
from zoedepth.stored import read_depth
from zoedepth.weights import load


@pytest.fixture(autouse=True)
def asked(tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """Every model name gives the tiny model; what it is loaded with is kept."""
    options: dict[str, object] = {}
    monkeypatch.setattr(load, "load_model", lambda name, **given: options.update(given) or tiny_model)
    monkeypatch.setattr(load, "load_for_prediction", lambda name, device, **given: load.load_model(name, **given))
    return options


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    return write_photo(tmp_path / "photo.png", size=(30, 40))


def predict(*arguments: object, out: Path) -> int:
    return main(["predict", *map(str, arguments), "--out", str(out)])


def at_photo(monkeypatch: pytest.MonkeyPatch, name: str, act: Callable[[], None]) -> None:
    """Let something happen when the prediction of the photo of this name begins."""
    call = Predictor.__call__

    def acting(self: Predictor, image: object, **options: Any) -> DepthMap:
        if Path(str(image)).name == name:
            act()
        return call(self, image, **options)

    monkeypatch.setattr(Predictor, "__call__", acting)


def names(folder: Path) -> set[str]:
    """Return the files below a folder, without the manifest and its lock."""
    files = (file for file in folder.rglob("*") if file.is_file() and "zoedepth-manifest" not in file.name)
    return {file.relative_to(folder).as_posix() for file in files}


class TestOptions:
    def test_none(self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
        assert predict(photo, out=tmp_path / "out") == 0
        assert names(tmp_path / "out") == {"photo_depth.png", "photo_preview.jpg", "photo.json"}
        expected = Predictor(tiny_model)(photo)
        np.testing.assert_allclose(read_depth(tmp_path / "out/photo_depth.png"), expected.depth, atol=5.1e-4)
        sidecar = json.loads((tmp_path / "out/photo.json").read_text())
        assert (sidecar["model"], sidecar["config_size"]) == ("zoed-lite", [64, 64])
        assert sidecar["domain_probability"] == pytest.approx(expected.domain_probability, abs=1e-4)

    def test_of_the_prediction(
        self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth, asked: dict[str, object]
    ) -> None:
        options = ["--no-flip", "--pad", "yes", "--domain", "outdoor", "--png-scale", "500", "--workers", "3"]
        assert predict(photo, *options, "--compat", "batch-vote", "squeeze", out=tmp_path / "out") == 0
        expected = Predictor(tiny_model, flip_average=False, pad=True)(photo, domain="outdoor")
        np.testing.assert_allclose(read_depth(tmp_path / "out/photo_depth.png"), expected.depth, atol=1.1e-3)
        sidecar = json.loads((tmp_path / "out/photo.json").read_text())
        assert (sidecar["domain"], sidecar["png_scale"]) == ("outdoor", 500)
        assert asked["compat"] == ("batch-vote", "squeeze")
        assert (asked["precision"], asked["streams"]) == ("float32", 1)

    @pytest.mark.parametrize(
        ("options", "files"),
        [
            (["--no-preview"], {"photo_depth.png"}),
            (["--save", "npz"], {"photo.npz"}),
            (["--save", "depth", "npy", "preview"], {"photo_depth.png", "photo_depth.npy", "photo_preview.jpg"}),
            (["--save", "preview", "npz", "--no-preview"], {"photo.npz"}),
            (["--save", "png,tif", "color"], {"photo_depth.png", "photo_depth.tiff", "photo_color.png"}),
            (["--relative"], {"photo_relative.png", "photo_preview.jpg"}),
            (["--relative", "--save", "png,jpg"], {"photo_relative.png", "photo_preview.jpg"}),
            (["--relative", "--save", "npz"], {"photo.npz"}),
        ],
    )
    def test_of_the_files(self, photo: Path, tmp_path: Path, options: list[str], files: set[str]) -> None:
        assert predict(photo, "--no-flip", *options, out=tmp_path / "out") == 0
        assert names(tmp_path / "out") == {*files, "photo.json"}

    @pytest.mark.parametrize(("given", "most"), [(["--max-triangles", "150"], 150), (["--max-triangles", "0"], 10_000)])
    def test_of_a_mesh(self, tmp_path: Path, given: list[str], most: int) -> None:
        pytest.importorskip("fast_simplification")
        photo = write_photo(tmp_path / "photo.png", size=(60, 80))
        assert predict(photo, "--no-flip", "--save", "glb", *given, out=tmp_path / "out") == 0
        triangles = json.loads((tmp_path / "out/photo.json").read_text())["triangles"]
        assert most / 4 < triangles <= most

    def test_of_a_panorama(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        photos = [write_photo(tmp_path / name, size=size) for name, size in (("a.png", (32, 64)), ("b.png", (32, 50)))]
        options = ["--no-flip", "--panorama", "--save", "npz,ply", "--json"]
        assert predict(*photos, *options, out=tmp_path / "out") == 1
        captured = capsys.readouterr()
        good, bad = map(json.loads, captured.out.splitlines())
        assert (good["projection"], good["size"], good["camera"]) == ("equirectangular", [32, 64], None)
        assert "twice as wide as high, and this has 50 x 32 pixels" in bad["error"]
        with np.load(tmp_path / "out/a.npz") as arrays:
            assert (str(arrays["projection"]), arrays["depth"].shape) == ("equirectangular", (32, 64))
        assert names(tmp_path / "out") == {"a.npz", "a.ply", "a.json"}

    def test_of_tiles(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        photo = write_photo(tmp_path / "photo.png", size=(130, 190))
        options = ["--no-flip", "--save", "npy", "--tiles"]
        assert predict(photo, *options, "2x3", out=tmp_path / "out") == 0
        assert json.loads((tmp_path / "out/photo.json").read_text())["tiles"] == [2, 3]
        assert predict(photo, *options, "2x3", out=tmp_path / "out") == 0
        assert "is done already" in capsys.readouterr().err
        assert predict(photo, *options, "auto", out=tmp_path / "out") == 0  # another depth
        assert json.loads((tmp_path / "out/photo.json").read_text())["tiles"] == [2, 2]
        assert predict(photo, *options, "9x9", out=tmp_path / "out") == 1
        assert "less than half of what the network sees" in capsys.readouterr().err
        assert predict(photo, *options, "many", out=tmp_path / "out") == 2
        assert "tiles (--tiles) are auto, or rows x columns" in capsys.readouterr().err

    def test_model_without_metric_heads_gives_relative_depth(
        self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        bare = ZoeDepth(replace(tiny_model.config, domains=())).eval()
        monkeypatch.setattr("zoedepth.weights.load.load_model", lambda name, **_: bare)
        assert predict(photo, out=tmp_path / "out") == 0
        assert names(tmp_path / "out") == {"photo_relative.png", "photo_preview.jpg", "photo.json"}
        assert predict(photo, "--panorama", out=tmp_path / "out") == 2

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--domain", "moon"], "moon"),
            (["--png-scale", "-1"], "scale"),
            (["--vmin", "5", "--vmax", "1"], "vmin"),
            (["--colormap", "jet"], "jet"),
            (["--save", "depth,exe"], "'exe'"),
            (["--max-triangles", "-1"], "--max-triangles"),
            (["--workers", "-1"], "--workers must be 1 or more"),
            (["--address", "auto"], "--address is that of a Ray cluster: give --engine ray, too"),
            (["--relative", "--domain", "indoor"], "no metres"),
            (["--relative", "--png-scale", "256"], "no metres"),
            (["--relative", "--vmax", "3"], "no metres"),
        ],
    )
    def test_a_wrong_one_is_found_before_the_first_photo(
        self, photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
    ) -> None:
        assert predict(photo, *options, out=tmp_path / "out") == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_help_names_every_kind_of_file(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("COLUMNS", "160")
        with pytest.raises(SystemExit):
            main(["predict", "--help"])
        printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
        assert all(f"{name}: NAME{output.ending}, {output.summary}" in printed for name, output in OUTPUTS.items())

    def test_json_has_a_line_for_each_photo_on_standard_output(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        write_photo(tmp_path / "in" / "a.png", size=(30, 40))
        (tmp_path / "in" / "b.png").write_bytes(b"no picture")
        assert predict(tmp_path / "in", tmp_path / "gone.jpg", "--no-flip", "--json", out=tmp_path / "out") == 1
        captured = capsys.readouterr()
        gone, good, bad = map(json.loads, captured.out.splitlines())
        sidecar = json.loads((tmp_path / "out" / "a.json").read_text())
        assert good == {
            "photo": str(tmp_path / "in" / "a.png"),
            "files": {
                "depth": str(tmp_path / "out" / "a_depth.png"),
                "preview": str(tmp_path / "out" / "a_preview.jpg"),
                "sidecar": str(tmp_path / "out" / "a.json"),
            },
            "size": [30, 40],
            **{key: sidecar[key] for key in ("depth", "domain", "projection", "camera", "seconds")},
            "focal_correction": 1.0,
            "calibration": None,
            "error": None,
        }
        assert good["depth"].keys() == {"min", "median", "max"}
        assert (gone["photo"], gone["error"]) == (str(tmp_path / "gone.jpg"), "no such file or folder")
        assert "is not an image" in bad["error"]
        assert good.keys() == bad.keys() == gone.keys()
        assert bad["files"] == {}
        assert "1 of 2 photos written" in captured.err

    def test_out_must_be_writable(
        self, photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """Found before a model is loaded."""
        monkeypatch.setattr("zoedepth.weights.load.load_model", None)
        (tmp_path / "file").touch()
        assert predict(photo, out=tmp_path / "file" / "out") == 2
        assert f"cannot write to {tmp_path / 'file' / 'out'}" in capsys.readouterr().err

    def test_out_must_not_hold_files_of_others(
        self, photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """Where one photo can be written, it is; where none can, that is said before a model is loaded."""
        (tmp_path / "photo.json").write_text('{"shapes": []}')
        other = write_photo(tmp_path / "other.png")
        assert predict(photo, other, out=tmp_path) == 1
        assert "1 of 2 photos written, 1 failed" in capsys.readouterr().err
        monkeypatch.setattr("zoedepth.weights.load.load_model", None)
        assert predict(photo, out=tmp_path) == 2
        printed = capsys.readouterr().err
        assert "photo.json is not from zoedepth and would be replaced" in printed
        assert "So it is with all" not in printed
        (tmp_path / "other.json").write_text('{"shapes": []}')
        assert predict(photo, other, out=tmp_path) == 2
        assert "So it is with all 2 photos" in capsys.readouterr().err
        assert {(tmp_path / f"{name}.json").read_text() for name in ("photo", "other")} == {'{"shapes": []}'}

    def test_out_must_be_a_folder(self, photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert predict(photo, out=photo) == 2
        assert "is a file: give a folder" in capsys.readouterr().err


class TestCamera:
    """Of a model that knows the focal length of its training photos, canonical or not."""

    @pytest.fixture
    def model(self, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> ZoeDepth:
        domains = tuple(replace(domain, focal_px=50.0) for domain in tiny_model.config.domains)
        tiny_model.config = replace(tiny_model.config, domains=domains)
        return tiny_model

    def sidecar(self, photo: Path, *options: object) -> dict[str, Any]:
        out = photo.parent / "out"
        assert predict(photo, "--no-flip", "--save", "npy", *options, out=out) == 0
        return json.loads((out / f"{photo.stem}.json").read_text())

    @pytest.mark.parametrize(
        ("options", "known"),
        [
            (["--fov-x", 70], Lens(fov_x=70)),
            (["--fov-y", 50], Lens(fov_y=50)),
            (["--fov-diagonal", 80], Lens(fov_diagonal=80)),
            (["--focal-px", 33.3], Lens(focal_px=33.3)),
            (["--intrinsics", 33.3, 44.4, 20.1, 14.2], Intrinsics(33.3, 44.4, 20.1, 14.2)),
        ],
    )
    def test_an_option_gives_it_and_depth_is_corrected(
        self, photo: Path, model: ZoeDepth, options: list[object], known: Lens | Intrinsics
    ) -> None:
        expected = Predictor(model, flip_average=False)(photo, camera=known)
        sidecar = self.sidecar(photo, *options)
        assert sidecar["camera"] == {**asdict(expected.camera), "size": [30, 40]}
        assert sidecar["camera"]["source"] == "given"
        assert sidecar["focal_correction"] == expected.focal_correction != 1
        np.testing.assert_array_equal(np.load(photo.parent / "out" / "photo_depth.npy"), expected.depth)
        uncorrected = self.sidecar(photo, *options, "--focal-correction", "no")
        assert uncorrected["camera"] == sidecar["camera"]
        assert uncorrected["focal_correction"] == 1

    def test_a_file_and_a_sidecar_give_it(self, photo: Path, model: ZoeDepth, tmp_path: Path) -> None:
        np.savetxt(tmp_path / "k.txt", [[33.3, 0, 20.1], [0, 44.4, 14.2], [0, 0, 1]])
        sidecar = self.sidecar(photo, "--camera", tmp_path / "k.txt")
        assert (sidecar["camera"]["fx"], sidecar["camera"]["cy"]) == (33.3, 14.2)
        shutil.copy(tmp_path / "out" / "photo.json", tmp_path / "camera.json")
        assert self.sidecar(photo, "--camera", tmp_path / "camera.json")["camera"] == sidecar["camera"]

    def test_notes_give_it_unless_nobody_shall_be_asked(self, tmp_path: Path, model: ZoeDepth) -> None:
        exif = Image.Exif()
        exif[0x0112] = 6
        exif.get_ifd(0x8769)[0xA405] = 26
        photo = tmp_path / "photo.jpg"
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, 30, 3), np.uint8)).save(photo, exif=exif)
        for options in ([], ["--camera", "exif"]):
            sidecar = self.sidecar(photo, *options)
            assert (sidecar["camera"]["source"], sidecar["camera"]["size"]) == ("exif", [30, 40])
            assert "26 mm" in sidecar["camera_note"]
            assert sidecar["focal_correction"] == 1  # this model was not trained in one camera
        corrected = self.sidecar(photo, "--focal-correction", "yes")
        expected = Predictor(model, flip_average=False, focal_correction=True)(photo)
        assert corrected["focal_correction"] == expected.focal_correction != 1
        np.testing.assert_array_equal(np.load(tmp_path / "out" / "photo_depth.npy"), expected.depth)
        sidecar = self.sidecar(photo, "--camera", "none")
        assert sidecar["camera"]["source"] == "assumed"
        assert "camera_note" not in sidecar

    def test_how_many_nobody_knows_is_said_where_it_matters(
        self, model: ZoeDepth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        photos = [write_photo(tmp_path / f"{index}.png") for index in range(3)]
        for canonical, options, said in (
            (True, [], True),
            (True, ["--camera", "none"], False),
            (True, ["--focal-correction", "no"], False),
            (True, ["--fov-x", "60"], False),
            (False, [], False),
            (False, ["--focal-correction", "yes"], True),
        ):
            model.config = replace(model.config, canonical_camera=canonical)
            assert predict(*photos, "--no-flip", "--save", "npy", *options, out=tmp_path / "out") == 0
            assert ("3 without a known camera" in capsys.readouterr().err) == said
        assert "no EXIF" in json.loads((tmp_path / "out" / "1.json").read_text())["camera_note"]

    def test_photos_that_it_is_not_of_fail(
        self, photo: Path, model: ZoeDepth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """The first says the size; half of it is the same camera, and another shape is not."""
        half, other = write_photo(tmp_path / "q.png", size=(15, 20)), write_photo(tmp_path / "r.png", size=(30, 30))
        assert predict(photo, half, other, "--no-flip", "--focal-px", 50, out=tmp_path / "out") == 1
        assert "of photos of 40 x 30 pixels, and the photo has 30 x 30" in capsys.readouterr().err
        assert json.loads((tmp_path / "out" / "q.json").read_text())["camera"]["fx"] == 25

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--camera", "exif", "--fov-x", "70"], "--camera and --fov-x each say the camera"),
            (["--camera", "nowhere.yaml"], "there is no file 'nowhere.yaml'"),
            (["--fov-x", "0"], "between 0 and 180"),
            (["--fov-diagonal", "nan"], "between 0 and 180"),
            (["--focal-px", "-1400"], "focal length"),
            (["--intrinsics", "0", "50", "20", "15"], "focal length"),
            (["--intrinsics", "500", "500", "320", "240"], "far from the middle of a photo of 40 x 30"),
            (["--relative", "--fov-x", "70"], "no metres"),
            (["--relative", "--focal-correction", "yes"], "no metres"),
            (["--panorama", "--fov-x", "70"], "a panorama looks everywhere and has no camera"),
            (["--panorama", "--relative"], "relative depth has none"),
            (["--focal-correction", "yes"], "does not say with what focal length"),
            (["--calibration", "nowhere.json"], "nowhere.json"),
        ],
    )
    def test_a_wrong_option_is_found_before_the_first_photo(
        self, photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
    ) -> None:
        assert predict(photo, *options, out=tmp_path / "out") == 2
        assert message in " ".join(capsys.readouterr().err.replace("│", " ").split())
        assert not (tmp_path / "out").exists()

    def test_a_calibration_puts_the_metres_right_and_is_told(
        self, photo: Path, tiny_model: ZoeDepth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        plain = Predictor(tiny_model, flip_average=False)(photo)
        calibration = Calibration(2.5, scale_error=0.1, camera=plain.camera, domain=plain.domain, network="zoed-lite")
        write_calibration(tmp_path / "c.json", calibration)
        sidecar = self.sidecar(photo, "--calibration", tmp_path / "c.json")
        np.testing.assert_array_equal(np.load(tmp_path / "out" / "photo_depth.npy"), calibration.apply(plain.depth))
        assert Calibration.from_json(sidecar["calibration"]) == calibration
        assert (
            predict(photo, "--no-flip", "--calibration", tmp_path / "c.json", "--fov-x", 120, out=tmp_path / "o") == 1
        )
        assert "the calibration does not hold for this photo" in capsys.readouterr().err
        assert predict(photo, "--relative", "--calibration", tmp_path / "c.json", out=tmp_path / "o") == 2
        assert "no metres: leave out calibration" in capsys.readouterr().err


class TestFast:
    @pytest.fixture
    def fast(self, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
        """The fastest is torch in bfloat16; returns what was asked for."""
        options: dict[str, object] = {}

        def load(name: str, **given: object) -> Fast:
            options.update(given, name=name)
            return Fast(tiny_model, "torch, bfloat16", "it [was] measured", "bfloat16", "cpu")

        monkeypatch.setattr("zoedepth.runtimes.fast.load_fast", load)
        return options

    def test_what_computes_is_said_and_told_in_the_sidecar(
        self,
        photo: Path,
        tmp_path: Path,
        tiny_model: ZoeDepth,
        fast: dict[str, object],
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        assert predict(photo, "--fast", "--save", "npy", "--compat", "squeeze", out=tmp_path / "out") == 0
        assert "Fast: torch, bfloat16 (it [was] measured)" in capsys.readouterr().err
        assert json.loads((tmp_path / "out/photo.json").read_text())["runtime"] == "torch, bfloat16"
        expected = Predictor(tiny_model, precision="bfloat16")(photo).depth
        np.testing.assert_allclose(np.load(tmp_path / "out/photo_depth.npy"), expected, rtol=2e-2)
        assert (fast["name"], fast["compat"], fast["device"], fast["streams"], fast["metres"]) == (
            "zoed-lite", ("squeeze",), "auto", 1, True,
        )  # fmt: skip

    def test_relative_depth_is_asked_for(self, photo: Path, tmp_path: Path, fast: dict[str, object]) -> None:
        assert predict(photo, "--fast", "--relative", out=tmp_path / "out") == 0
        assert fast["metres"] is False

    def test_a_job_of_another_runtime_is_another_job(
        self, tmp_path: Path, fast: dict[str, object], capsys: pytest.CaptureFixture[str]
    ) -> None:
        write_photo(tmp_path / "in/a.png")
        assert predict(tmp_path / "in", "--fast", out=tmp_path / "out") == 0
        assert predict(tmp_path / "in", "--model", "m.pt", out=tmp_path / "out") == 2
        said = " ".join(capsys.readouterr().err.split())
        assert 'runtime was "torch, bfloat16" and is now "torch, float32"' in said
        assert predict(tmp_path / "in", "--fast", out=tmp_path / "out") == 0

    @pytest.mark.parametrize("options", [["--precision", "bfloat16"], ["--engine", "ray"]])
    def test_what_leaves_no_choice_is_refused(
        self, photo: Path, tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert predict(photo, "--fast", *options, out=tmp_path / "out") == 2
        assert options[0] in capsys.readouterr().err


class TestRay:
    """The engine ray: ``tests/jobs/test_ray_engine.py`` tests the work itself."""

    @pytest.fixture
    def told(self, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
        """In the place of Ray this process does the photos; returns what Ray would have been told."""
        kept: dict[str, Any] = {}

        def run(inputs: Iterable[Input], predictor: Predictor, request: Request, **options: Any) -> Iterator[Done]:
            kept.update(options, on=predictor.model.device.type, files=request.names)
            for photo in inputs:
                done = do_photo(photo, predictor, request, options["destination"])
                options["manifest"].add(done.entry)
                options["tally"].count(done)
                yield done

        monkeypatch.setattr("zoedepth.jobs.ray_engine.run_on_ray", run)
        return kept

    @pytest.mark.parametrize(
        ("n_photos", "options", "expected"),
        [
            (2, [], ("zoed-lite", "auto", None, None, False, False)),
            (2, ["--json"], ("zoed-lite", "auto", None, None, False, True)),
            (1, ["--workers", "0"], ("zoed-lite", "auto", None, None, False, True)),
            (2, ["--model", "m.pt", "--device", "cuda", "--workers", "3", "--address", "head:6379", "--overwrite"],
             ("m.pt", "cuda", 3, "head:6379", True, False)),
        ],
    )  # fmt: skip
    def test_all_that_it_needs_arrives_and_its_results_are_told(
        self, tmp_path: Path, told: dict[str, Any], capsys: pytest.CaptureFixture[str], n_photos: int,
        options: list[str], expected: tuple[object, ...],
    ) -> None:  # fmt: skip
        photos = [write_photo(tmp_path / f"{index}.png") for index in range(n_photos)]
        command = [*photos, "--no-flip", "--save", "npy", "--engine", "ray", *options]
        assert predict(*command, out=tmp_path / "out") == 0
        asked = ("model", "device", "workers", "address", "overwrite", "tell_done")
        assert tuple(told[name] for name in asked) == expected
        assert (told["on"], told["files"]) == ("cpu", ("npy",)), "the actors have the GPUs"
        assert f"{n_photos} of {n_photos} photos written" in capsys.readouterr().err
        assert {name for name in names(tmp_path / "out") if name.endswith(".npy")} == {
            f"{photo.stem}_depth.npy" for photo in photos
        }

    def test_a_stream_is_refused(
        self, photo: Path, told: dict[str, Any], capsysbinary: pytest.CaptureFixture[bytes]
    ) -> None:
        assert predict(photo, "--engine", "ray", out=Path("-")) == 2
        assert b"--out - is for one photo: leave --engine out" in capsysbinary.readouterr().err
        assert told == {}


class TestWhatItSays:
    def test_how_many_were_written_and_which_failed(
        self, photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        write_photo(tmp_path / "in" / "[a].jpg")
        (tmp_path / "in" / "[b].jpg").write_bytes(b"no picture")
        (tmp_path / "in" / "notes.txt").touch()
        threads = torch.get_num_threads()
        sources = [tmp_path / "in", tmp_path / "missing.jpg", photo]
        assert predict(*sources, "--no-flip", "--workers", "2", out=tmp_path / "out") == 1
        printed = capsys.readouterr().err
        assert "2 of 3 photos written, 2 failed, 1 other files" in printed
        assert f"failed {tmp_path / 'in' / '[b].jpg'}" in printed
        assert "missing.jpg: no such file" in printed
        assert {"[a]_depth.png", "photo_depth.png"} <= names(tmp_path / "out")
        assert torch.get_num_threads() == threads

    def test_nothing_to_do(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "notes.txt").touch()
        for source in (tmp_path, tmp_path / "missing.jpg", tmp_path / "*.jpg"):
            assert predict(source, out=tmp_path / "out") == 2
            assert "No photos to predict" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_what_was_left_out_and_why(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_photo(tmp_path / "@eaDir" / "a.png" / "SYNOPHOTO_THUMB_M.jpg")
        for name in ("a.CR3", "b.cr3"):
            (tmp_path / name).touch()
        assert predict(tmp_path, out=tmp_path / "out") == 2
        printed = capsys.readouterr().err
        assert "left out (1): in @eaDir" in printed
        assert "left out (2): .cr3 files, which are raw: develop them" in printed
        assert "3 other files" in printed

    def test_a_full_disk(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for index in range(9):
            write_photo(tmp_path / "in" / f"{index}.jpg")

        def full(*_: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr("zoedepth.outputs.sidecar.write_sidecar", full)
        assert predict(tmp_path / "in", "--no-flip", "--workers", "1", out=tmp_path / "out") == 1
        printed = capsys.readouterr().err
        assert "Make room, and run it again" in printed
        assert "Stopped: 0 of 9 photos written" in printed

    def test_ended_by_the_system(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        at_photo(monkeypatch, "1.jpg", lambda: os.kill(os.getpid(), signal.SIGTERM))
        before = signal.getsignal(signal.SIGTERM)
        photos = [write_photo(tmp_path / f"{index}.jpg") for index in range(20)]
        assert predict(*photos, "--no-flip", "--no-preview", "--workers", "1", out=tmp_path / "out") == 143
        said = re.search(r"Terminated: (\d+) of 20 photos written", capsys.readouterr().err)
        assert said is not None
        written = names(tmp_path / "out")  # the signal may come between a photo's end and its count
        assert 2 * int(said[1]) <= len(written) < 40
        assert {Path(name).suffix for name in written} == {".png", ".json"}
        assert signal.getsignal(signal.SIGTERM) is before

    def test_what_the_files_could_not_hold(
        self, photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        call = Predictor.__call__

        def far(self: Predictor, image: object, **options: Any) -> DepthMap:
            result = call(self, image, **options)
            result.depth[:] = 70
            return result

        monkeypatch.setattr(Predictor, "__call__", far)
        assert predict(photo, "--no-flip", out=tmp_path / "out") == 0
        assert re.search(r"1 beyond 65\.535 m: .*256 levels", capsys.readouterr().err)
        assert predict(photo, "--no-flip", "--png-scale", "1000", out=tmp_path / "out") == 0
        assert "1 clipped" in capsys.readouterr().err

    def test_interrupted(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def interrupt() -> NoReturn:
            raise KeyboardInterrupt

        at_photo(monkeypatch, "1.jpg", interrupt)
        photos = [write_photo(tmp_path / f"{index}.jpg") for index in range(3)]
        assert predict(*photos, "--no-flip", "--no-preview", "--workers", "1", out=tmp_path / "out") == 130
        error = capsys.readouterr().err
        said = re.search(r"Interrupted: ([12]) of 3 photos written", error)  # one more may have begun
        assert said is not None
        assert "type the same command again: what is done is not done twice" in error
        assert predict(*photos, "--workers", "1", "--overwrite", out=tmp_path / "anew") == 130
        assert "type the same command without --overwrite: what is done" in capsys.readouterr().err
        assert len(names(tmp_path / "out")) == 2 * int(said[1])


class TestJobs:
    """Typed again: ``tests/jobs`` tests the work itself."""

    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        for index in range(3):
            write_photo(tmp_path / "in" / f"{index}.png", seed=index)
        return tmp_path / "in"

    def test_a_folder_is_done_once(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        out = tmp_path / "out"
        (folder / "bad.png").write_bytes(b"no picture")
        assert predict(folder, "--no-flip", "--json", out=out) == 1
        first = capsys.readouterr()
        assert "3 of 4 photos written, 1 failed, 0 other files" in first.err
        monkeypatch.setattr(Predictor, "__call__", None)  # nothing is predicted any more
        (folder / "bad.png").unlink()
        assert predict(folder, "--no-flip", "--json", out=out) == 0
        second = capsys.readouterr()
        assert "All 3 photos are done already. To do them again: --overwrite" in second.err
        assert "0 of 3 photos written, 0 failed, 3 done before" in second.err
        assert second.out.splitlines() == [line for line in first.out.splitlines() if "bad.png" not in line]

    def test_other_options_are_refused_unless_all_is_done_again(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert predict(folder, "--no-flip", out=tmp_path / "out") == 0
        assert predict(folder, out=tmp_path / "out") == 2
        assert "flip was false and is now true" in capsys.readouterr().err
        assert predict(folder, "--overwrite", out=tmp_path / "out") == 0
        assert "3 of 3 photos written" in capsys.readouterr().err

    def test_a_photo_that_is_named_is_done_once_for_the_same_options(
        self, photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for options, said in (
            ([], "1 of 1 photos written"),
            ([], f"{photo} is done already: {tmp_path / 'out' / 'photo_depth.png'}, "),
            (["--no-flip"], "1 of 1 photos written"),
            (["--no-flip"], "To do it again: --overwrite"),
            (["--no-flip", "--overwrite"], "1 of 1 photos written"),
        ):
            assert predict(photo, *options, out=tmp_path / "out") == 0
            assert said in capsys.readouterr().err

    def test_shards(self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        for shard in ("0/2", "1/2"):
            assert predict(folder, "--no-flip", "--no-preview", "--shard", shard, out=tmp_path / "out") == 0
        assert names(tmp_path / "out") == {f"{i}{end}" for i in range(3) for end in ("_depth.png", ".json")}
        assert predict(folder, "--shard", "99999/100000", out=tmp_path / "out") == 0
        assert "No photos in shard 99999/100000" in capsys.readouterr().err
        assert predict(folder, "--shard", "2/2", out=tmp_path / "out") == 2
        assert "--shard must be i/n" in capsys.readouterr().err

    def test_no_folder_and_no_preview(self, photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["predict", str(photo), "--out", ""]) == 2
        assert "--out is empty: give a folder" in capsys.readouterr().err
        for nothing in (["preview"], ["jpg"], [".jpg,preview"], []):
            assert (
                predict(photo, *(["--save", *nothing] if nothing else ["--save", ""]), "--no-preview", out="out") == 2
            )
            assert "--save names nothing to write, or the preview alone" in capsys.readouterr().err

    def test_shards_take_pixels_for_those_of_one_photo(self, tmp_path: Path) -> None:
        for name, size in (("a", (30, 40)), ("b", (60, 80)), ("c", (15, 20))):
            write_photo(tmp_path / "in" / f"{name}.png", size=size)
        for shard in ("0/1", "0/2", "1/2"):
            out = tmp_path / shard[2:]
            assert predict(tmp_path / "in", "--focal-px", 50, "--no-flip", "--shard", shard, out=out) == 0
        focal = {
            out: [json.loads((tmp_path / out / f"{name}.json").read_text())["camera"]["fx"] for name in "abc"]
            for out in ("1", "2")
        }
        assert focal["1"] == focal["2"] == [50, 100, 25]

    def test_shards_of_nothing(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """A folder without a photo, such as that of a disk that is not there, is not done."""
        (tmp_path / "disk").mkdir()
        (tmp_path / "list.txt").write_text("\n")
        for source in (tmp_path / "disk", tmp_path / "list.txt"):
            assert predict(source, "--shard", "0/4", out=tmp_path / "out") == 2
            assert "No photos to predict" in capsys.readouterr().err
        (tmp_path / "list.txt").write_text(f"{write_photo(tmp_path / 'a.png')}\n")
        assert predict(tmp_path / "list.txt", "--shard", "99999/100000", out=tmp_path / "out") == 0

    def test_more_photos_than_are_listed_first(
        self, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr("zoedepth.jobs.inputs.N_FIRST", 2)
        (folder / "gone.png").symlink_to("nowhere.png")
        assert predict(folder, "--no-flip", "--no-preview", out=tmp_path / "out") == 1
        assert re.search(r"3( of 4)? photos written, 1 failed", capsys.readouterr().err)

    def test_they_are_counted_only_where_something_is_to_do(
        self, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        counted: list[object] = []
        monkeypatch.setattr("zoedepth.jobs.inputs.N_FIRST", 2)
        monkeypatch.setattr("zoedepth.jobs.run.count_in_background", lambda tally, count: counted.append(count))
        for _ in range(2):
            assert predict(folder, "--no-flip", "--no-preview", "--json", out=tmp_path / "out") == 0
            assert len(counted) == 1

    def test_a_list_with_a_column(self, folder: Path, tmp_path: Path) -> None:
        (tmp_path / "list.csv").write_text("name,where\n" + "".join(f"{i},in/{i}.png\n" for i in range(3)))
        options = ["--column", "where", "--focal-px", "30", "--no-flip", "--no-preview"]
        assert predict(tmp_path / "list.csv", *options, out=tmp_path / "out") == 0
        assert names(tmp_path / "out") == {f"in/{i}{end}" for i in range(3) for end in ("_depth.png", ".json")}

    def test_a_photo_that_takes_too_long_is_left_after_sigterm(self, tmp_path: Path) -> None:
        """In a process of its own, which ends at once."""
        write_photo(tmp_path / "a.png")
        program = (
            "import os, signal, sys, time\n"
            "from types import SimpleNamespace\n"
            "import zoedepth.commands.predict as command\n"
            "from zoedepth.jobs.run import Tally\n"
            "from rich.console import Console\n"
            "command._PATIENCE = 0.2\n"
            "found = SimpleNamespace(found=SimpleNamespace(n_ignored=0))\n"
            "options = dict(json_=False, streamed=False, overwrite=False)\n"
            "report = command._Report(found, None, Tally(done=7), Console(stderr=True), set(), **options)\n"
            "with command._terminated_as_interrupted(report._give_up):\n"
            "    try:\n"
            "        os.kill(os.getpid(), signal.SIGTERM)\n"
            "        time.sleep(600)\n"
            "    except KeyboardInterrupt:\n"
            "        time.sleep(600)\n"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=600)
        assert done.returncode == 143
        assert "Terminated: 7 photos written" in done.stderr
        assert "type the same command again" in " ".join(done.stderr.split())
