"""The predict command: nothing is lost, nothing is overwritten, and the exit code says how it went."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from zoedepth.batch import find_photos
from zoedepth.cli import main
from zoedepth.commands.predict import predict
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.stored import read_depth


@pytest.fixture(autouse=True)
def shipped_model(tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> ZoeDepth:
    """Every model name gives the tiny model."""
    monkeypatch.setattr("zoedepth.weights.load.load_model", lambda name, **_: tiny_model)
    return tiny_model


def write_photo(path: Path, *, size: tuple[int, int] = (12, 16), seed: int = 0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    return path


def names(folder: Path) -> set[str]:
    """Files below a folder, as paths relative to it."""
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}


class TestOutputs:
    def test_one_photo(self, tmp_path: Path, shipped_model: ZoeDepth) -> None:
        photo = write_photo(tmp_path / "photo.jpg", size=(30, 40))
        out = tmp_path / "out"
        assert main(["predict", str(photo), "--out", str(out)]) == 0
        assert names(out) == {"photo_depth.png", "photo_preview.jpg", "photo.json"}
        expected = Predictor(shipped_model)(photo)
        np.testing.assert_allclose(read_depth(out / "photo_depth.png"), expected.depth, atol=5.1e-4)
        sidecar = json.loads((out / "photo.json").read_text())
        assert sidecar["source"] == str(photo)
        assert sidecar["model"] == "zoed-lite"
        assert sidecar["unit"] == "metre"
        assert sidecar["png_scale"] == 1000
        assert sidecar["input_size"] == [30, 40]
        assert sidecar["config_size"] == [64, 64]
        assert sidecar["network_size"] == list(expected.network_size)
        assert sidecar["domain"] == expected.domain
        assert sidecar["domain_probability"] == pytest.approx(expected.domain_probability, abs=1e-4)
        assert sidecar["depth"]["median"] == pytest.approx(np.median(expected.depth), abs=1e-4)
        assert sidecar["files"] == {"depth": "photo_depth.png", "preview": "photo_preview.jpg"}

    def test_options(self, tmp_path: Path, shipped_model: ZoeDepth) -> None:
        photo = write_photo(tmp_path / "photo.png", size=(30, 40))
        options = ["--no-preview", "--no-flip", "--pad", "yes", "--domain", "outdoor", "--png-scale", "500"]
        assert main(["predict", str(photo), "-o", str(tmp_path / "out"), *options]) == 0
        assert names(tmp_path / "out") == {"photo_depth.png", "photo.json"}
        expected = Predictor(shipped_model, flip_average=False, pad=True)(photo, domain="outdoor")
        np.testing.assert_allclose(read_depth(tmp_path / "out/photo_depth.png"), expected.depth, atol=1.1e-3)
        sidecar = json.loads((tmp_path / "out/photo.json").read_text())
        assert (sidecar["domain"], sidecar["png_scale"]) == ("outdoor", 500)

    def test_far_depth_takes_the_scale_it_fits(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        call = Predictor.__call__

        def far(self: Predictor, image: object, *, domain: str | None = None) -> object:
            result = call(self, image, domain=domain)
            result.depth[:] = 70
            return result

        monkeypatch.setattr(Predictor, "__call__", far)
        photo = write_photo(tmp_path / "photo.png")
        assert predict((str(photo),), out=tmp_path / "out", flip=False) == 0
        assert "256 levels per metre" in capsys.readouterr().err
        assert json.loads((tmp_path / "out/photo.json").read_text())["png_scale"] == 256
        assert (read_depth(tmp_path / "out/photo_depth.png") == 70).all()

        assert predict((str(photo),), out=tmp_path / "out", flip=False, png_scale=1000.0) == 0
        assert "1 clipped" in capsys.readouterr().err
        assert read_depth(tmp_path / "out/photo_depth.png").max() == np.float32(65.535)


class TestFolder:
    def test_a_hundred_good_and_broken_files_lose_nothing(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder, good, broken = tmp_path / "in", [], []
        suffixes = (".jpg", ".png", ".JPG", ".tif", ".webp")
        for index in range(100):
            path = folder / f"day {index % 3}" / f"[{index:02d}] é{suffixes[index % 5]}"
            write_photo(path, size=(5 + index % 7, 16 - index % 5), seed=index)
            if index % 4:
                good.append(path)
                continue
            broken.append(path)
            data = path.read_bytes()
            kinds = [data[: len(data) // 2], b"", b"not an image", data[:20]]
            path.write_bytes(kinds[index // 4 % 4])
        (folder / "notes.txt").write_text("not a photo")
        write_photo(folder / ".hidden.jpg")

        assert predict((str(folder),), out=tmp_path / "out", preview=False, flip=False) == 1
        stems = {path.relative_to(folder).with_suffix("").as_posix() for path in good}
        assert len(stems) == 75
        assert names(tmp_path / "out") == {f"{stem}{ending}" for stem in stems for ending in ("_depth.png", ".json")}
        printed = capsys.readouterr().err
        assert "75 of 100 photos written, 25 failed, 2 other files" in printed
        assert all(f"failed {path}" in printed for path in broken)
        for path in good:
            depth = read_depth(
                tmp_path / "out" / path.relative_to(folder).with_suffix("").with_name(f"{path.stem}_depth.png")
            )
            with Image.open(path) as picture:
                assert depth.shape == picture.size[::-1]

    def test_second_run_gives_the_same_files(self, tmp_path: Path) -> None:
        """Also where depth is written beside the photos: outputs are no inputs."""
        for index in range(3):
            write_photo(tmp_path / "sub" / f"{index}.jpg", seed=index)
        for _ in range(2):
            assert predict((str(tmp_path),), out=tmp_path, flip=False) == 0
            assert len(names(tmp_path)) == 12
        for _ in range(2):
            assert predict((str(tmp_path),), out=tmp_path / "sub", flip=False) == 0
            assert len(find_photos([str(tmp_path)], tmp_path).photos) == 3

    def test_an_input_is_never_overwritten(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """a_depth.png is no output of ours here, for there is no a.json beside it."""
        write_photo(tmp_path / "a.jpg")
        truth = write_photo(tmp_path / "a_depth.png").read_bytes()
        assert predict((str(tmp_path),), out=tmp_path, preview=False, flip=False) == 1
        assert (tmp_path / "a_depth.png").read_bytes() == truth
        assert "would overwrite another photo" in capsys.readouterr().err

    def test_folder_that_cannot_be_read_is_reported(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_photo(tmp_path / "closed" / "a.jpg")
        write_photo(tmp_path / "open" / "b.jpg")
        scandir = os.scandir

        def refuse(folder: str) -> object:  # not by its mode: root, who runs tests in containers, may read everything
            if Path(folder).name == "closed":
                raise PermissionError(13, "Permission denied", folder)
            return scandir(folder)

        monkeypatch.setattr(os, "scandir", refuse)
        found = find_photos([str(tmp_path)], tmp_path / "out")
        assert [photo.path.name for photo in found.photos] == ["b.jpg"]
        assert "closed" in found.failures[0]


class TestFindPhotos:
    def targets(self, *sources: object, out: Path) -> dict[str, str]:
        """Photo -> target, relative to the folder of the test."""
        found = find_photos([str(source) for source in sources], out)
        assert not found.failures
        return {
            photo.path.relative_to(out.parent).as_posix(): photo.target.relative_to(out).as_posix()
            for photo in found.photos
        }

    def test_photos_that_would_share_outputs_keep_their_suffix(self, tmp_path: Path) -> None:
        for name in ("a.jpg", "a.png", "A.bmp", "b.jpg", "a.jpg.png", "sub/a.jpg"):
            (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / name).touch()
        targets = self.targets(tmp_path / "in", out=tmp_path / "out")
        assert {source.removeprefix("in/"): target for source, target in targets.items()} == {
            "A.bmp": "A.bmp",
            "a.jpg": "a.jpg",
            "a.jpg.png": "a.jpg.png",
            "a.png": "a.png",
            "b.jpg": "b",
            "sub/a.jpg": "sub/a",
        }

    def test_several_folders_keep_their_names(self, tmp_path: Path) -> None:
        for name in ("left/a.jpg", "right/a.jpg"):
            (tmp_path / name).parent.mkdir()
            (tmp_path / name).touch()
        targets = self.targets(tmp_path / "left", tmp_path / "right", out=tmp_path / "out")
        assert targets == {"left/a.jpg": "left/a", "right/a.jpg": "right/a"}
        targets = self.targets(tmp_path / "left/a.jpg", tmp_path / "right/a.jpg", out=tmp_path / "out")
        assert targets == {"left/a.jpg": "a.jpg", "right/a.jpg": "a.jpg-2"}

    def test_glob_keeps_the_tree_below_its_fixed_part(self, tmp_path: Path) -> None:
        for name in ("in/a/1.jpg", "in/b/1.JPG", "in/b/notes.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        targets = self.targets(tmp_path / "in" / "**" / "*", out=tmp_path / "out")
        assert targets == {"in/a/1.jpg": "a/1", "in/b/1.JPG": "b/1"}

    def test_relative_sources(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "here").mkdir()
        for name in ("a.jpg", "here/b.jpg"):
            (tmp_path / name).touch()
        monkeypatch.chdir(tmp_path / "here")
        for sources in ([".."], ["../*.jpg", "*.jpg"], ["./*.jpg", "../a.jpg"]):
            found = find_photos(sources, Path("out"))
            assert {photo.path.name for photo in found.photos} == {"a.jpg", "b.jpg"}

    def test_each_photo_once(self, tmp_path: Path) -> None:
        (tmp_path / "a.jpg").touch()
        sources = (tmp_path / "a.jpg", tmp_path, tmp_path / "*.jpg", tmp_path / "a.jpg")
        assert self.targets(*sources, out=tmp_path / "out") == {"a.jpg": "a"}


class TestExitCodes:
    def test_nothing_to_do(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "notes.txt").touch()
        for source in (tmp_path, tmp_path / "missing.jpg", tmp_path / "*.jpg"):
            assert predict((str(source),), out=tmp_path / "out") == 2
            assert "No photos to predict" in capsys.readouterr().err
        assert predict((), out=tmp_path / "out") == 2
        assert not (tmp_path / "out").exists()

    def test_a_missing_source_fails_and_the_others_go_on(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        photo = write_photo(tmp_path / "photo.jpg")
        assert predict((str(tmp_path / "missing.jpg"), str(photo)), out=tmp_path / "out", flip=False) == 1
        assert "missing.jpg: no such file" in capsys.readouterr().err
        assert "photo_depth.png" in names(tmp_path / "out")

    def test_a_failure_of_the_model_or_the_disk_is_reported(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def run_out(*arguments: object, **options: object) -> None:
            raise RuntimeError("out of memory")

        monkeypatch.setattr(Predictor, "__call__", run_out)
        assert predict((str(write_photo(tmp_path / "photo.jpg")),), out=tmp_path / "out") == 1
        assert "RuntimeError: out of memory" in capsys.readouterr().err

    def test_several_workers_write_what_one_writes(self, tmp_path: Path) -> None:
        photos = [str(write_photo(tmp_path / f"{seed}.png", seed=seed)) for seed in range(7)]
        photos.insert(3, str(tmp_path / "broken.png"))
        (tmp_path / "broken.png").write_bytes(b"no picture")
        threads = torch.get_num_threads()
        for workers in (1, 3):
            assert predict(tuple(photos), out=tmp_path / str(workers), workers=workers) == 1
        assert torch.get_num_threads() == threads
        assert names(tmp_path / "1") == names(tmp_path / "3")
        assert len(names(tmp_path / "1")) == 21
        for seed in range(7):
            one, three = (read_depth(tmp_path / folder / f"{seed}_depth.png") for folder in ("1", "3"))
            np.testing.assert_allclose(one, three, atol=1.1e-3)
        with pytest.raises(InputError, match="--workers"):
            predict(tuple(photos), out=tmp_path / "out", workers=-1)

    def test_interrupted(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        call, n_calls = Predictor.__call__, 0

        def interrupt(self: Predictor, image: object, *, domain: str | None = None) -> object:
            nonlocal n_calls
            n_calls += 1
            if n_calls == 2:
                raise KeyboardInterrupt
            return call(self, image, domain=domain)

        monkeypatch.setattr(Predictor, "__call__", interrupt)
        photos = tuple(str(write_photo(tmp_path / f"{index}.jpg")) for index in range(3))
        assert predict(photos, out=tmp_path / "out", flip=False, preview=False, workers=1) == 130
        assert re.search(r"Interrupted: [12] of 3 photos written", capsys.readouterr().err)  # one more may have begun
        written = names(tmp_path / "out")
        assert {"0_depth.png", "0.json"} <= written <= {"0_depth.png", "0.json", "2_depth.png", "2.json"}

    @pytest.mark.parametrize(
        "options", [{"domain": "moon"}, {"png_scale": -1.0}, {"vmin": 5.0, "vmax": 1.0}, {"colormap": "jet"}]
    )
    def test_a_wrong_option_is_found_before_the_first_photo(self, tmp_path: Path, options: dict) -> None:
        photo = write_photo(tmp_path / "photo.jpg")
        with pytest.raises(InputError):
            predict((str(photo),), out=tmp_path / "out", **options)
        with pytest.raises(InputError, match="is a file"):
            predict((str(photo),), out=photo)
        assert not (tmp_path / "out").exists()


class TestRelative:
    def test_files(self, tmp_path: Path, shipped_model: ZoeDepth) -> None:
        photo, out = write_photo(tmp_path / "photo.jpg", size=(30, 40)), tmp_path / "out"
        assert main(["predict", str(photo), "-o", str(out), "--relative"]) == 0
        assert names(out) == {"photo_relative.png", "photo_preview.jpg", "photo.json"}
        sidecar = json.loads((out / "photo.json").read_text())
        low, high = sidecar["png_range"]
        with Image.open(out / "photo_relative.png") as picture:
            levels = np.array(picture)
            assert picture.text["RelativeMax"] == f"{high:.10g}"
        assert (levels.min(), levels.max()) == (0, 65535)
        expected = Predictor(shipped_model).relative(photo)
        np.testing.assert_allclose(low + levels / 65535 * (high - low), expected, atol=(high - low) / 65535)
        assert "no" in sidecar["unit"]

    def test_model_without_metric_heads_gives_nothing_else(
        self, tmp_path: Path, shipped_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        bare = ZoeDepth(replace(shipped_model.config, domains=())).eval()
        monkeypatch.setattr("zoedepth.weights.load.load_model", lambda name, **_: bare)
        photo = write_photo(tmp_path / "photo.jpg")
        assert main(["predict", str(photo), "-o", str(tmp_path / "out")]) == 0
        assert "photo_relative.png" in names(tmp_path / "out")

    @pytest.mark.parametrize("option", [["--domain", "indoor"], ["--png-scale", "256"], ["--vmax", "3"]])
    def test_metres_make_no_sense(self, tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
        photo = write_photo(tmp_path / "photo.jpg")
        assert main(["predict", str(photo), "-o", str(tmp_path / "out"), "--relative", *option]) == 2
        assert "no metres" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_earlier_outputs_are_no_photos(self, tmp_path: Path) -> None:
        write_photo(tmp_path / "photo.jpg")
        for _ in range(2):
            assert main(["predict", str(tmp_path), "-o", str(tmp_path), "--relative"]) == 0
        assert names(tmp_path) == {"photo.jpg", "photo_relative.png", "photo_preview.jpg", "photo.json"}


def test_compat_reaches_the_model(tmp_path: Path, shipped_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}
    monkeypatch.setattr(
        "zoedepth.weights.load.load_model", lambda name, **options: asked.update(options) or shipped_model
    )
    photo = write_photo(tmp_path / "photo.jpg")
    assert main(["predict", str(photo), "-o", str(tmp_path / "out"), "--compat", "batch-vote", "squeeze"]) == 0
    assert asked["compat"] == ("batch-vote", "squeeze")
