"""Many photos: nothing is lost, nothing is overwritten, and every photo has its outcome. No network, no console."""

import errno
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from threading import Barrier
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import ExifTags, Image
from tests.folders import write_photo

from zoedepth.batch import Outcome, Request, in_turn, predict_all, predict_photo
from zoedepth.calibration import Calibration, Reading
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.geometry.lens import Lens
from zoedepth.images import read_image, to_image
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import OUTPUTS, Maps, Options, sidecar, write_maps
from zoedepth.panorama import predict_panorama
from zoedepth.photos import Photo, find_photos
from zoedepth.predict import Predictor
from zoedepth.stored import read_depth
from zoedepth.tiles import predict_tiled


class Brightness(Predictor):
    """Predicts 1 m + the mean of the three colours / 255."""

    runtime = "brightness, float32"

    def __init__(self) -> None:
        self.model = SimpleNamespace(config=SimpleNamespace(size=(64, 96), canonical_camera=False))
        self.camera, self.focal_correction = "exif", None

    def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
        photo = to_image(image)
        depth = (1 + photo.mean(axis=2) / 255).astype(np.float32)
        probability = {"indoor": 0.123456, "outdoor": 0.9}
        camera = replace(Lens(fov_x=60).camera(depth.shape), source="assumed")
        return DepthMap(depth, depth / 4, domain or "indoor", probability, photo, (32, 64), camera)

    def relative(self, image: object) -> np.ndarray:
        return to_image(image).mean(axis=2).astype(np.float32)


REQUEST = Request("brightness")
CALIBRATION = Calibration(2.0, camera=Lens(fov_x=60).camera((12, 24)), readings=())
SPHERE = b'<x:xmpmeta xmlns:x="adobe:ns:meta/" GPano:ProjectionType="equirectangular"/>'


def write_sphere(path: Path, *, said: bool) -> Path:
    """Write a photo twice as wide as high, whose XMP says that it is a panorama, or does not."""
    noise = np.random.default_rng(0).integers(0, 256, (32, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path, **({"xmp": SPHERE} if said else {}))
    return path


def names(folder: Path) -> set[str]:
    """Files below a folder, as paths relative to it."""
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}


def fail_with(number: int) -> Callable[..., None]:
    """Return a function that fails as the system does."""

    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


def run(
    folder: Path, out: Path, request: Request = REQUEST, *, predictor: Predictor | None = None, workers: int = 1
) -> list[Outcome]:
    photos = find_photos([str(folder)], out).photos
    return list(predict_all(photos, predictor or Brightness(), request, workers=workers))


class TestInTurn:
    def test_items_are_asked_for_as_they_are_needed(self) -> None:
        asked = []

        def items() -> Iterator[int]:
            for number in range(100):
                asked.append(number)
                yield number

        results = in_turn(lambda number: -number, items(), workers=2, ahead=5)
        assert [next(results) for _ in range(3)] == [0, -1, -2]
        assert len(asked) <= 7
        results.close()
        assert list(in_turn(lambda number: -number, range(20), workers=3)) == [-number for number in range(20)]

    def test_no_more_are_asked_for_while_those_that_wait_hold_much(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("zoedepth.batch.MAX_HELD", 25)
        asked = []

        def items() -> Iterator[int]:
            for number in range(20):
                asked.append(number)
                yield number

        results = in_turn(lambda number: number, items(), workers=4, held=lambda number: 10)
        assert next(results) == 0
        assert len(asked) == 3
        assert list(results) == list(range(1, 20))

    def test_nothing_is_begun_after_a_reason_to_stop_and_what_was_begun_is_told(self) -> None:
        begun, told = [], []

        def work(number: int) -> int:
            begun.append(number)
            return number

        def stop() -> InputError | None:
            return InputError("full") if 3 in begun else None

        with pytest.raises(InputError, match="full"):
            told.extend(in_turn(work, range(1000), workers=1, stop=stop))
        assert sorted(told) == sorted(begun)
        assert len(begun) <= 10


class TestOwnFiles:
    """What was written is known wherever it lies, and what was not is never replaced."""

    EVERYTHING = Request("b", tuple(name for name, kind in OUTPUTS.items() if "depth" in kind.maps))

    def test_moved_and_renamed_outputs_are_no_photos(self, tmp_path: Path) -> None:
        write_photo(tmp_path / "in" / "a.jpg")
        run(tmp_path / "in", tmp_path / "out", self.EVERYTHING)
        moved = (tmp_path / "out").rename(tmp_path / "elsewhere")
        (moved / "a_depth.png").rename(moved / "front.png")
        (moved / "a_preview.jpg").rename(moved / "sub.jpg")
        (moved / "a.json").unlink()
        found = find_photos([str(moved)], tmp_path / "out")
        assert not found.photos
        assert found.left_out["written by zoedepth"] == 5  # color, depth as PNG, EXR and TIFF, preview

    def test_a_photo_with_such_a_name_is_one(self, tmp_path: Path) -> None:
        for name in ("a.jpg", "a_preview.jpg", "a_depth.png"):
            write_photo(tmp_path / name)
        run(tmp_path / "a.jpg", tmp_path, Request("b", ("npy",)))
        assert {photo.path.name for photo in find_photos([str(tmp_path)], tmp_path).photos} == {
            "a.jpg", "a_preview.jpg", "a_depth.png",
        }  # fmt: skip

    @pytest.mark.parametrize("kind", ["sidecar", *EVERYTHING.names])
    def test_what_is_not_ours_is_kept(self, tmp_path: Path, kind: str) -> None:
        """Other photos are predicted. An annotation that looks a little like a sidecar is one of somebody else."""
        for name in ("a.png", "b.png"):
            write_photo(tmp_path / "in" / name)
        foreign = tmp_path / f"a{'.json' if kind == 'sidecar' else OUTPUTS[kind].ending}"
        foreign.write_bytes(b'{"source": "a.png", "files": {"depth": "a_depth.png"}, "shapes": []}')
        first, second = run(tmp_path / "in", tmp_path, self.EVERYTHING)
        assert f"{foreign} is not from zoedepth and would be replaced" in str(first.failure)
        assert second.failure is None
        assert foreign.read_bytes().startswith(b'{"source"')
        assert {name for name in names(tmp_path) if name.startswith("a")} == {foreign.name}

    def test_truth_in_the_place_of_our_depth_is_not_ours(self, tmp_path: Path) -> None:
        """Although our sidecar lists a file of this name."""
        photo = write_photo(tmp_path / "in" / "a.png")
        run(photo, tmp_path / "out")
        truth = write_photo(tmp_path / "out" / "a_depth.png").read_bytes()
        (outcome,) = run(photo, tmp_path / "out")
        assert "not from zoedepth" in str(outcome.failure)
        assert (tmp_path / "out" / "a_depth.png").read_bytes() == truth

    @pytest.mark.parametrize("kind", ["npy", "npz", "pfm"])
    def test_so_are_arrays_that_nothing_but_the_sidecar_tells(self, tmp_path: Path, kind: str) -> None:
        photo, file = write_photo(tmp_path / "in" / "a.png"), tmp_path / "out" / f"a{OUTPUTS[kind].ending}"
        for _ in range(2):
            (outcome,) = run(photo, tmp_path / "out", Request("b", (kind,)))
            assert outcome.failure is None
        write_maps(file, Maps(depth=np.full((12, 16), 2.5, np.float32)))
        truth = file.read_bytes()
        (outcome,) = run(photo, tmp_path / "out", Request("b", (kind,)))
        assert "not from zoedepth" in str(outcome.failure)
        assert file.read_bytes() == truth

    def test_depth_of_another_photo_is_kept(self, tmp_path: Path) -> None:
        for name in ("left/a.png", "right/a.png", "left/a.jpg"):
            write_photo(tmp_path / name, seed=len(name))
        run(tmp_path / "left" / "a.png", tmp_path / "out")
        before = (tmp_path / "out" / "a_depth.png").read_bytes()
        for other in ("right/a.png", "left/a.jpg"):
            (outcome,) = run(tmp_path / other, tmp_path / "out")
            assert f"a.json is of {tmp_path / 'left' / 'a.png'}, another photo" in str(outcome.failure)
        assert (tmp_path / "out" / "a_depth.png").read_bytes() == before

    def test_a_photo_keeps_its_files_however_its_path_is_typed(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        photo = write_photo(tmp_path / "in" / "a.png")
        monkeypatch.chdir(photo.parent)
        for typed in (photo, Path("a.png"), Path("../in/./a.png")):
            (outcome,) = run(typed, tmp_path / "out")
            assert outcome.failure is None

    def test_files_of_earlier_runs_stay_known(self, tmp_path: Path) -> None:
        photo = write_photo(tmp_path / "in" / "a.png")
        for kind in ("npy", "depth", "npz", "npy"):
            (outcome,) = run(photo, tmp_path / "out", Request("b", (kind,)))
            assert outcome.failure is None
            assert outcome.files.keys() == {kind, "sidecar"}
        assert outcome.sidecar["files"] == {"npy": "a_depth.npy"}
        assert outcome.sidecar["other_files"] == ["a.npz", "a_depth.png"]

    def test_a_photo_that_fails_leaves_its_files_as_they_were(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        photo = write_photo(tmp_path / "in" / "a.png")
        run(photo, tmp_path / "out")
        before = {name: (tmp_path / "out" / name).read_bytes() for name in names(tmp_path / "out")}
        write_photo(photo, seed=1)
        monkeypatch.setattr(sidecar, "write_sidecar", fail_with(errno.EFBIG))
        (outcome,) = run(photo, tmp_path / "out")
        assert "its files cannot be written" in str(outcome.failure)
        assert {name: (tmp_path / "out" / name).read_bytes() for name in names(tmp_path / "out")} == before


class TestPredictPhoto:
    def test_writes_depth_preview_and_sidecar(self, tmp_path: Path) -> None:
        photo = Photo(write_photo(tmp_path / "a.jpg"), tmp_path / "out" / "b" / "a")
        outcome = predict_photo(photo, Brightness(), REQUEST)
        assert names(tmp_path / "out") == {"b/a_depth.png", "b/a_preview.jpg", "b/a.json"}
        expected = Brightness()(photo.path)
        np.testing.assert_allclose(read_depth(photo.file("_depth.png")), expected.depth, atol=5.1e-4)
        sidecar = json.loads(photo.file(".json").read_text())
        assert sidecar == json.loads(json.dumps(outcome.sidecar))
        assert sidecar.pop("seconds") >= 0
        assert sidecar.pop("zoedepth")
        assert sidecar.pop("depth").keys() == {"min", "median", "max"}
        assert sidecar == {
            "source": str(photo.path),
            "model": "brightness",
            "config_size": [64, 96],
            "input_size": [12, 16],
            "network_size": [32, 64],
            "domain": "indoor",
            "domain_probability": {"indoor": 0.1235, "outdoor": 0.9},
            "focal_correction": 1.0,
            "runtime": "brightness, float32",
            "camera": json.loads(json.dumps(asdict(expected.camera))),
            "unit": "metre",
            "projection": "perspective",
            "depth_along": "optical axis",
            "depth_range": [0.0, None],
            "png_scale": 1000,
            "median_confidence": 0.8,
            "files": {"depth": "a_depth.png", "preview": "a_preview.jpg"},
        }

    def test_a_photo_that_a_calibration_is_not_of_fails_and_the_others_go_on(self, tmp_path: Path) -> None:
        write_photo(tmp_path / "in" / "a.png", size=(12, 16))
        write_photo(tmp_path / "in" / "b.png", size=(12, 12))
        plain = Brightness()(tmp_path / "in" / "a.png")
        calibration = Calibration(3.0, camera=plain.camera, readings=(Reading(((1, 2),), 3.0, 1.0, 3.0),))
        request = Request("brightness", ("npy",), calibration=calibration)
        outcomes = {outcome.photo.path.name: outcome for outcome in run(tmp_path / "in", tmp_path / "out", request)}
        np.testing.assert_allclose(np.load(tmp_path / "out" / "a_depth.npy"), 3 * plain.depth)
        assert outcomes["a.png"].sidecar["calibration"] == replace(calibration, readings=()).to_json()
        assert "does not hold for this photo: its photo has 16 x 12 pixels" in str(outcomes["b.png"].failure)
        assert names(tmp_path / "out") == {"a_depth.npy", "a.json"}

    def test_a_camera_that_nobody_knows_is_noted_where_depth_would_be_corrected(self, tmp_path: Path) -> None:
        photo = Photo(write_photo(tmp_path / "a.jpg"), tmp_path / "out" / "a")
        predictor = Brightness()
        assert predict_photo(photo, predictor, REQUEST).notes == ()
        predictor.focal_correction = True
        (note,) = predict_photo(photo, predictor, REQUEST).notes
        assert note.startswith("without a known camera: that of the training photos was assumed")
        predictor.camera = "none"
        assert predict_photo(photo, predictor, REQUEST).notes == ()

    @pytest.mark.parametrize("asked_for", [True, False])
    def test_a_panorama_is_looked_at_in_parts(self, tmp_path: Path, asked_for: bool, tiny_model: ZoeDepth) -> None:
        photo = Photo(write_sphere(tmp_path / "a.jpg", said=not asked_for), tmp_path / "out" / "a")
        domains = tuple(replace(domain, focal_px=50.0) for domain in tiny_model.config.domains)
        tiny_model.config = replace(tiny_model.config, domains=domains)
        predictor = Predictor(tiny_model)
        request = Request("tiny", ("npy", "depth", "tiff", "exr"), domain="outdoor", panorama=asked_for)
        sidecar = predict_photo(photo, predictor, request).sidecar
        expected = predict_panorama(predictor, photo.path, domain="outdoor")
        assert np.array_equal(np.load(photo.file("_depth.npy")), expected.distance)
        assert (sidecar["projection"], sidecar["depth_along"]) == ("equirectangular", "ray")
        assert (sidecar["domain"], sidecar["views"], sidecar["input_size"]) == ("outdoor", 22, (32, 64))
        assert "camera" not in sidecar
        assert sidecar["focal_correction"] == expected.focal_correction != 1
        with Image.open(photo.file("_depth.png")) as png, Image.open(photo.file("_depth.tiff")) as tiff:
            assert "along the ray" in png.info["Description"]
            assert "along the ray" in str(tiff.getexif()[ExifTags.Base.ImageDescription])
        OpenEXR = pytest.importorskip("OpenEXR")
        header = OpenEXR.File(str(photo.file("_depth.exr"))).header()
        assert header["envmap"] == OpenEXR.ENVMAP_LATLONG
        assert "along the ray" in header["comments"]

    def test_a_panorama_has_no_camera_and_no_calibration(self, tmp_path: Path, tiny_model: ZoeDepth) -> None:
        photo = Photo(write_sphere(tmp_path / "a.jpg", said=True), tmp_path / "out" / "a")
        with pytest.raises(InputError, match="it is a panorama, which looks everywhere and has no camera"):
            predict_photo(photo, Predictor(tiny_model, camera=Lens(fov_x=60)), REQUEST)
        elsewhere = Photo(photo.path, tmp_path / "other" / "a")
        assert predict_photo(elsewhere, Predictor(tiny_model, camera="none"), REQUEST).failure is None
        with pytest.raises(InputError, match="leave the calibration out"):
            predict_photo(photo, Predictor(tiny_model), Request("tiny", calibration=CALIBRATION))
        photo = Photo(write_photo(tmp_path / "b.jpg"), tmp_path / "out" / "b")
        with pytest.raises(InputError, match="twice as wide as high"):
            predict_photo(photo, Predictor(tiny_model), Request("tiny", panorama=True))
        assert not (tmp_path / "out").exists()

    def test_tiles_are_told_and_so_is_where_they_would_add_nothing(self, tmp_path: Path, tiny_model: ZoeDepth) -> None:
        predictor = Predictor(tiny_model, flip_average=False)
        large = Photo(write_photo(tmp_path / "a.jpg", size=(130, 190)), tmp_path / "out" / "a")
        outcome = predict_photo(large, predictor, Request("tiny", ("npy",), tiles="auto"))
        expected = predict_tiled(predictor, large.path)
        np.testing.assert_allclose(np.load(large.file("_depth.npy")), expected.depth, rtol=1e-5)
        assert (outcome.sidecar["tiles"], expected.tiles, outcome.notes) == ((2, 2), (2, 2), ())
        small = Photo(write_photo(tmp_path / "b.jpg", size=(60, 70)), tmp_path / "out" / "b")
        sphere = Photo(write_sphere(tmp_path / "c.jpg", said=True), tmp_path / "out" / "c")
        for photo in (small, sphere):
            outcome = predict_photo(photo, predictor, Request("tiny", ("npy",), tiles="auto"))
            assert "tiles" not in outcome.sidecar
            assert [note for note in outcome.notes if "tiles would add nothing" in note] == list(outcome.notes)
        np.testing.assert_allclose(np.load(small.file("_depth.npy")), predictor(small.path).depth, rtol=1e-5)

    def test_relative_depth(self, tmp_path: Path) -> None:
        photo = Photo(write_photo(tmp_path / "a.jpg"), tmp_path / "out" / "a")
        sidecar = predict_photo(photo, Brightness(), Request("brightness", relative=True)).sidecar
        assert names(tmp_path / "out") == {"a_relative.png", "a_preview.jpg", "a.json"}
        relative = Brightness().relative(photo.path)
        assert sidecar["png_range"] == [relative.min(), relative.max()]
        assert sidecar["files"] == {"relative": "a_relative.png", "preview": "a_preview.jpg"}

    @pytest.mark.parametrize("relative", [False, True])
    def test_every_output_can_be_asked_for(self, tmp_path: Path, relative: bool) -> None:
        kinds = tuple(name for name, kind in OUTPUTS.items() if ("relative" if relative else "depth") in kind.maps)
        photo = Photo(write_photo(tmp_path / "a.jpg"), tmp_path / "out" / "a")
        outcome = predict_photo(photo, Brightness(), Request("brightness", outputs=kinds, relative=relative))
        assert outcome.sidecar["files"] == {name: f"a{OUTPUTS[name].ending}" for name in kinds}
        assert names(tmp_path / "out") == {"a.json", *(f"a{OUTPUTS[name].ending}" for name in kinds)}

    def test_domain_and_options_arrive(self, tmp_path: Path) -> None:
        photo = Photo(write_photo(tmp_path / "a.jpg"), tmp_path / "out" / "a")
        request = Request("brightness", ("depth",), Options(png_scale=100_000.0), domain="outdoor")
        outcome = predict_photo(photo, Brightness(), request)
        assert (outcome.sidecar["domain"], outcome.sidecar["png_scale"]) == ("outdoor", 100_000)
        assert any("clipped" in note for note in outcome.notes)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"outputs": ("dpeth",)}, "no output 'dpeth': did you mean depth"),
        ({"outputs": ("relative",)}, "'relative' cannot be written from depth in metres"),
        ({"outputs": ("npz", "depth"), "relative": True}, "'depth' cannot be written from relative depth"),
        ({"relative": True, "panorama": True}, "relative depth has none"),
        ({"panorama": True, "calibration": CALIBRATION}, "leave the calibration out"),
        ({"panorama": True, "tiles": "auto"}, "seen in parts anyway"),
        ({"relative": True, "tiles": (2, 2)}, "tiles are joined by their metres"),
        ({"tiles": (2, 99)}, "each from 1 to 32"),
        ({"relative": True, "domain": "indoor"}, "no metres: leave out domain"),
        ({"relative": True, "options": Options(png_scale=256.0, vmax=3.0)}, "png_scale, vmax"),
    ],
)
def test_a_wrong_request_is_found_before_the_first_photo(request_: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Request("brightness", **request_)


class TestPredictAll:
    def test_a_hundred_good_and_broken_files_lose_nothing(self, tmp_path: Path) -> None:
        folder, broken = tmp_path / "in", []
        suffixes = (".jpg", ".png", ".JPG", ".tif", ".webp")
        for index in range(100):
            path = folder / f"day {index % 3}" / f"[{index:02d}] é{suffixes[index % 5]}"
            write_photo(path, size=(5 + index % 7, 16 - index % 5), seed=index)
            if index % 4 == 0:
                broken.append(path)
                data = path.read_bytes()
                path.write_bytes([data[: len(data) // 2], b"", b"not an image", data[:20]][index // 4 % 4])
        (folder / "notes.txt").write_text("not a photo")
        write_photo(folder / ".hidden.jpg")
        found = find_photos([str(folder)], tmp_path / "out")
        assert found.n_ignored == 2
        outcomes = list(predict_all(found.photos, Brightness(), Request("b", ("depth",)), workers=3))
        assert [outcome.photo for outcome in outcomes] == found.photos
        assert {outcome.photo.path for outcome in outcomes if outcome.failure} == set(broken)
        assert all(str(outcome.photo.path) in outcome.failure for outcome in outcomes if outcome.failure)
        stems = {path.relative_to(folder).with_suffix("").as_posix()
                 for path in folder.rglob("[[]*") if path not in broken}  # fmt: skip
        assert len(stems) == 75
        assert names(tmp_path / "out") == {f"{stem}{ending}" for stem in stems for ending in ("_depth.png", ".json")}
        for outcome in outcomes:
            if outcome.failure is None:
                depth = read_depth(outcome.photo.file("_depth.png"))
                assert depth.shape == read_image(outcome.photo.path).shape[:2]

    @pytest.mark.parametrize("relative", [False, True])
    def test_a_second_run_gives_the_same_files(self, tmp_path: Path, relative: bool) -> None:
        """Also where depth is written beside the photos: outputs are no inputs."""
        for index in range(3):
            write_photo(tmp_path / "sub" / f"{index}.jpg", seed=index)
        for out in (tmp_path, tmp_path / "sub"):
            before: set[str] = set()
            for _ in range(2):
                outcomes = run(tmp_path, out, Request("brightness", relative=relative))
                assert len(outcomes) == 3
                assert not any(outcome.failure for outcome in outcomes)
                assert names(tmp_path) == (before or names(tmp_path))
                before = names(tmp_path)

    def test_an_input_is_never_overwritten(self, tmp_path: Path) -> None:
        """a_depth.png is no output of ours here, for there is no a.json beside it."""
        write_photo(tmp_path / "a.jpg")
        truth = write_photo(tmp_path / "a_depth.png").read_bytes()
        failures = {outcome.photo.path.name: outcome.failure for outcome in run(tmp_path, tmp_path)}
        assert "a_depth.png would overwrite another photo" in failures["a.jpg"]
        assert failures["a_depth.png"] is None
        assert (tmp_path / "a_depth.png").read_bytes() == truth

    def test_a_failure_of_the_model_or_the_disk_is_one_photo_s(self, tmp_path: Path) -> None:
        class OutOfMemory(Brightness):
            def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
                if Path(str(image)).name == "1.png":
                    raise RuntimeError("out of memory")
                return super().__call__(image, domain=domain)

        for seed in range(3):
            write_photo(tmp_path / "in" / f"{seed}.png", seed=seed)
        outcomes = run(tmp_path / "in", tmp_path / "out", predictor=OutOfMemory())
        assert [outcome.failure is None for outcome in outcomes] == [True, False, True]
        assert "1.png: RuntimeError: out of memory" in str(outcomes[1].failure)
        assert not {name for name in names(tmp_path / "out") if name.startswith("1")}

    @pytest.mark.parametrize(
        ("number", "goes_on"), [(errno.ENOSPC, False), (errno.EDQUOT, False), (errno.EFBIG, True), (errno.EACCES, True)]
    )
    def test_a_full_disk_ends_the_work_and_one_bad_file_does_not(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, goes_on: bool
    ) -> None:
        photos = self.twenty(tmp_path)
        write, failing = sidecar.write_sidecar, fail_with(number)
        monkeypatch.setattr(
            sidecar, "write_sidecar", lambda path, values: (failing if path.name == "01.json" else write)(path, values)
        )
        told, end = self.told(photos)
        assert [outcome.photo.path.name for outcome in told if outcome.failure] == ["01.png"]
        assert (len(told) == 20, end == "") == (goes_on, goes_on)
        assert goes_on or ("nothing more can be written" in end and os.strerror(number) in end)
        stems = [outcome.photo.target.name for outcome in told if outcome.failure is None]
        written = {f"{stem}{end}" for stem in stems for end in ("_depth.png", "_preview.jpg", ".json")}
        assert names(tmp_path / "out") == written

    def test_a_folder_that_becomes_unwritable_ends_the_work(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        photos = self.twenty(tmp_path)
        monkeypatch.setattr(sidecar, "write_sidecar", fail_with(errno.EACCES))
        monkeypatch.setattr("zoedepth.folders.TemporaryFile", fail_with(errno.EACCES))
        told, end = self.told(photos)
        assert 1 <= len(told) < 20
        assert end.startswith("cannot write to")
        assert names(tmp_path / "out") == set()

    def twenty(self, folder: Path) -> list[Photo]:
        for seed in range(20):
            write_photo(folder / "in" / f"{seed:02d}.png", seed=seed)
        return find_photos([str(folder / "in")], folder / "out").photos

    def told(self, photos: list[Photo]) -> tuple[list[Outcome], str]:
        """Return the outcomes, and the error that ended them."""
        outcomes = []
        try:
            for outcome in predict_all(photos, Brightness(), REQUEST):
                outcomes.append(outcome)
        except InputError as error:
            return outcomes, str(error)
        return outcomes, ""

    def test_at_least_one_worker(self, tmp_path: Path) -> None:
        for workers in (0, -1):
            with pytest.raises(InputError, match="workers must be 1 or more"):
                next(predict_all([], Brightness(), REQUEST, workers=workers))

    def test_several_workers_run_at_the_same_time_and_write_what_one_writes(self, tmp_path: Path) -> None:
        for seed in range(6):
            write_photo(tmp_path / "in" / f"{seed}.png", seed=seed)
        barrier = Barrier(3, timeout=60)

        class Together(Brightness):
            def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
                barrier.wait()  # until three are here
                return super().__call__(image, domain=domain)

        run(tmp_path / "in", tmp_path / "1")
        run(tmp_path / "in", tmp_path / "3", predictor=Together(), workers=3)
        assert names(tmp_path / "1") == names(tmp_path / "3")
        for seed in range(6):
            one, three = ((tmp_path / out / f"{seed}_depth.png").read_bytes() for out in ("1", "3"))
            assert one == three

    def test_what_has_begun_when_interrupted_is_finished_and_told(self, tmp_path: Path) -> None:
        class Interrupt(Brightness):
            def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
                if Path(str(image)).name == "1.png":
                    raise KeyboardInterrupt
                return super().__call__(image, domain=domain)

        for seed in range(20):
            write_photo(tmp_path / "in" / f"{seed:02d}.png".replace("01", "1"), seed=seed)
        photos = find_photos([str(tmp_path / "in")], tmp_path / "out").photos
        told = []

        def consume() -> None:
            for outcome in predict_all(photos, Interrupt(), Request("b", ("depth",))):
                told.append(outcome)

        with pytest.raises(KeyboardInterrupt):
            consume()
        stems = {outcome.photo.target.name for outcome in told}
        assert 0 < len(stems) < 20
        assert names(tmp_path / "out") == {f"{stem}{ending}" for stem in stems for ending in ("_depth.png", ".json")}

    def test_a_closed_iterator_leaves_no_file_half_written(self, tmp_path: Path) -> None:
        for seed in range(20):
            write_photo(tmp_path / "in" / f"{seed}.png", seed=seed)
        outcomes = predict_all(find_photos([str(tmp_path / "in")], tmp_path / "out").photos, Brightness(), REQUEST)
        first = next(outcomes)
        outcomes.close()
        written = names(tmp_path / "out")
        assert first.photo.file(".json").exists()
        stems = {name.removesuffix(".json") for name in written if name.endswith(".json")}
        assert written == {f"{stem}{end}" for stem in stems for end in ("_depth.png", "_preview.jpg", ".json")}
