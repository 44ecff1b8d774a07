"""Files that were written with a calibration are put back to what the model says."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.batch import Request, predict_all
from zoedepth.calibration import Calibration, is_calibrated, undo_files
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import Options
from zoedepth.outputs.sidecar import read_sidecar
from zoedepth.photos import find_photos
from zoedepth.predict import Predictor
from zoedepth.stored import read_depth, read_npz

OUTPUTS = ("depth", "npy", "npz", "preview", "color", "ply")


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "photo.png"
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    return path


def write(
    photo: Path,
    out: Path,
    model: ZoeDepth,
    calibration: Calibration | None,
    outputs: tuple[str, ...] = OUTPUTS,
    max_depth: float | None = None,
) -> Path:
    """Predict a photo, and return its sidecar."""
    request = Request("tiny", outputs, Options(max_depth=max_depth), calibration=calibration)
    (outcome,) = predict_all(find_photos([str(photo)], out).photos, Predictor(model, flip_average=False), request)
    assert outcome.failure is None
    return out / "photo.json"


@pytest.mark.parametrize("power", [1.0, 1.2])
def test_the_range_of_the_model_is_as_before(photo: Path, tmp_path: Path, tiny_model: ZoeDepth, power: float) -> None:
    plain = read_sidecar(write(photo, tmp_path / "plain", tiny_model, None))
    sidecar = write(photo, tmp_path / "calibrated", tiny_model, Calibration(scale=1.7, power=power))
    calibrated = read_sidecar(sidecar)
    undo_files(sidecar)
    undone = read_sidecar(sidecar)
    assert plain is not None
    assert calibrated is not None
    assert undone is not None
    assert plain["depth_range"][1] > plain["depth_range"][0] > 0
    assert undone["depth_range"] == pytest.approx(plain["depth_range"], rel=1e-5)
    assert calibrated["depth_range"] == pytest.approx([1.7 * end**power for end in plain["depth_range"]], rel=1e-5)


@pytest.mark.parametrize("power", [1.0, 1.2])
def test_all_files_are_as_without_the_calibration(
    photo: Path, tmp_path: Path, tiny_model: ZoeDepth, power: float
) -> None:
    plain = write(photo, tmp_path / "plain", tiny_model, None)
    sidecar = write(photo, tmp_path / "calibrated", tiny_model, Calibration(scale=1.7, power=power))
    assert is_calibrated(sidecar)
    assert not is_calibrated(plain)
    changed = read_npz(sidecar.with_name("photo.npz"))
    files = undo_files(sidecar)
    assert files[-1] == sidecar
    assert not is_calibrated(sidecar)
    assert {file.name for file in files} == {file.name for file in sidecar.parent.iterdir()}
    for name in ("depth", "std"):
        mine, theirs = (read_npz(path.with_name("photo.npz"), name=name) for path in (sidecar, plain))
        np.testing.assert_allclose(mine, theirs, rtol=1e-5)
    assert np.abs(changed / read_npz(plain.with_name("photo.npz")) - 1).min() > 0.3
    for name in ("photo_depth.npy", "photo_depth.png"):
        mine, theirs = (read_depth(path.with_name(name)) for path in (sidecar, plain))
        np.testing.assert_allclose(mine, theirs, atol=1.1e-3)
    for name in ("photo_preview.jpg", "photo_color.png"):
        mine, theirs = (np.asarray(Image.open(path.with_name(name))).astype(int) for path in (sidecar, plain))
        assert np.abs(mine - theirs).mean() < 1
    mine, theirs = (read_sidecar(path) for path in (sidecar, plain))
    assert mine is not None
    assert theirs is not None
    assert mine.keys() == theirs.keys()
    assert mine["depth"] == pytest.approx(theirs["depth"], abs=2e-4)
    assert mine["depth_range"] == pytest.approx(theirs["depth_range"])
    differing = {key for key in mine if mine[key] != theirs[key]}
    assert differing <= {"depth", "depth_range", "seconds", "color_range", "median_confidence"}


def test_points_end_where_they_ended(photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
    plain = write(photo, tmp_path / "plain", tiny_model, None)
    with np.load(plain.with_name("photo.npz")) as arrays:
        end = float(np.median(arrays["depth"][arrays["valid"]])) + 1e-3
    cut = write(photo, tmp_path / "cut", tiny_model, None, max_depth=end)
    sidecar = write(photo, tmp_path / "calibrated", tiny_model, Calibration(scale=1.7), max_depth=1.7 * end)
    undo_files(sidecar)
    values = [read_sidecar(path) for path in (plain, cut, sidecar)]
    assert [None if each is None else each.get("max_depth") for each in values] == [
        None, pytest.approx(end), pytest.approx(end, rel=1e-5),
    ]  # fmt: skip
    assert values[0] is not None
    assert values[1] is not None
    assert values[1]["depth_range"] == values[0]["depth_range"], "the range is the model's"
    n_points = [
        int(re.search(rb"element vertex (\d+)", path.with_name("photo.ply").read_bytes()).group(1))
        for path in (plain, cut, sidecar)
    ]
    assert n_points[0] > n_points[1]
    assert abs(n_points[1] - n_points[2]) <= 1  # a point at the very end, by rounding


def test_a_png_alone_is_enough(photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
    plain = write(photo, tmp_path / "plain", tiny_model, None, ("depth",))
    sidecar = write(photo, tmp_path / "out", tiny_model, Calibration(scale=0.5), ("depth",))
    photo.unlink()  # nothing shows it
    undo_files(sidecar)
    mine, theirs = (read_depth(path.with_name("photo_depth.png")) for path in (sidecar, plain))
    np.testing.assert_allclose(mine, theirs, atol=1.6e-3)


def test_what_is_farther_than_before_is_not_clipped(photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
    plain = write(photo, tmp_path / "plain", tiny_model, None, ("npy",))
    depth = read_depth(plain.with_name("photo_depth.npy"))
    scale = 0.75 * 65535 / float(depth.max())  # fits depth that is halved, and not the whole
    request = Request(
        "tiny", ("npy", "depth"), calibration=Calibration(scale=0.5), options=Options(png_scale=2 * scale)
    )
    found = find_photos([str(photo)], tmp_path / "out")
    (outcome,) = predict_all(found.photos, Predictor(tiny_model, flip_average=False), request)
    assert outcome.failure is None
    undo_files(tmp_path / "out" / "photo.json")
    np.testing.assert_allclose(read_depth(tmp_path / "out" / "photo_depth.png"), depth, atol=1e-3)


class TestRefuses:
    @pytest.fixture
    def sidecar(self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> Path:
        return write(photo, tmp_path / "out", tiny_model, Calibration(scale=2.0), ("depth", "preview"))

    def check(self, sidecar: Path, message: str) -> None:
        """Undo fails with this message and changes nothing."""
        before = {file: file.read_bytes() for file in sidecar.parent.iterdir() if file.is_file()}
        with pytest.raises(InputError, match=message):
            undo_files(sidecar)
        assert {file: file.read_bytes() for file in before} == before
        assert {file for file in sidecar.parent.iterdir() if file.is_file()} == before.keys()

    def test_what_was_not_calibrated(self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
        self.check(write(photo, tmp_path / "plain", tiny_model, None), "no sidecar of a calibrated photo")
        self.check(photo, "no sidecar of a calibrated photo")

    def test_a_second_time(self, sidecar: Path) -> None:
        undo_files(sidecar)
        self.check(sidecar, "no sidecar of a calibrated photo")

    def test_where_files_of_an_earlier_command_may_be_calibrated_too(
        self, sidecar: Path, photo: Path, tiny_model: ZoeDepth
    ) -> None:
        write(photo, sidecar.parent, tiny_model, Calibration(scale=2.0), ("npz",))
        again = write(photo, sidecar.parent, tiny_model, Calibration(scale=2.0), ("depth", "preview"))
        self.check(again, r"photo\.npz is of an earlier command, .*: remove it")

    def test_depth_that_was_put_back_already(self, sidecar: Path) -> None:
        """A command was killed before the sidecar had its place."""
        content = sidecar.read_bytes()
        undo_files(sidecar)
        sidecar.write_bytes(content)
        with pytest.raises(InputError, match="has been put back already, or changed"):
            undo_files(sidecar)

    def test_without_the_photo_that_its_files_show(self, sidecar: Path, photo: Path) -> None:
        photo.unlink()
        self.check(sidecar, "show the photo. Or predict the photo again")

    def test_with_another_photo(self, sidecar: Path, photo: Path) -> None:
        Image.new("RGB", (50, 40)).save(photo)
        self.check(sidecar, "of another size than its depth")

    def test_files_that_are_gone_or_of_others(self, sidecar: Path) -> None:
        depth = sidecar.with_name("photo_depth.png")
        Image.fromarray(np.ones((30, 40), np.uint16)).save(depth)
        self.check(sidecar, "photo_depth.png is gone, or not from zoedepth")
        depth.unlink()
        self.check(sidecar, "photo_depth.png is gone")

    def test_without_a_file_of_metres(self, photo: Path, tmp_path: Path, tiny_model: ZoeDepth) -> None:
        sidecar = write(photo, tmp_path / "out", tiny_model, Calibration(scale=2.0), ("preview",))
        self.check(sidecar, "none of the files of .* holds its depth in metres")

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"files": {"depth": "../photo_depth.png"}}, "not from zoedepth"),
            ({"files": {"exe": "photo_depth.png"}}, "not from zoedepth"),
            ({"calibration": {"scale": 0}}, "scale"),
            ({"camera": {"fx": 1}}, "camera"),
        ],
    )
    def test_sidecars_that_were_tampered_with(self, sidecar: Path, changes: dict, message: str) -> None:
        (sidecar.parent.parent / "photo_depth.png").write_bytes(sidecar.with_name("photo_depth.png").read_bytes())
        sidecar.write_text(json.dumps(json.loads(sidecar.read_text()) | changes))
        self.check(sidecar, message)
