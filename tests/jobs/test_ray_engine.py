"""Ray maps the same function: the same files and manifest as from one process."""

import re
import tarfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from tests.jobs.photos import contents, entries, write_photo, write_photos

from zoedepth.batch import Request
from zoedepth.errors import InputError
from zoedepth.jobs import ray_engine
from zoedepth.jobs.inputs import Sources
from zoedepth.jobs.place import job_place
from zoedepth.jobs.ray_engine import Recipe, run_on_ray
from zoedepth.jobs.run import Tally, run_job
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.work import Done
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.threads import threads
from zoedepth.weights.exported import ExportedModel, load_exported
from zoedepth.weights.releases import ASSETS

REQUEST = Request("tiny", ("npy",))


def on_ray(
    sources: Sources, out: Path, predictor: Predictor, *, address: str | None = "local", **options: bool
) -> tuple[list[Done], Tally]:
    tally, place = Tally(), job_place(out, JobShard())
    with place.opened() as manifest:
        manifest.begin({}, named=False)
        results = run_on_ray(
            sources.inputs(), predictor, REQUEST, model="tiny", device="cpu", manifest=manifest,
            destination=place.destination, workers=1, address=address, tally=tally, **options,
        )  # fmt: skip
        return list(results), tally


def test_it_does_what_one_process_does(tmp_path: Path, tiny_model: ZoeDepth) -> None:
    pytest.importorskip("ray", reason="the extra [ray] is not installed")
    folder = write_photos(tmp_path / "in", 10)
    (folder / "bad.png").write_bytes(b"no picture")
    predictor, sources = Predictor(tiny_model, flip_average=False), Sources((str(folder),))
    place, tally = job_place(tmp_path / "expected", JobShard()), Tally()
    with place.opened() as manifest:
        manifest.begin({}, named=False)
        list(run_job(sources.inputs(), predictor, REQUEST, manifest=manifest, destination=place.destination, workers=1,
                     tally=tally))  # fmt: skip
    results, tally = on_ray(sources, tmp_path / "out", predictor)
    assert (tally.done, tally.failed, len(results)) == (10, 1, 11)
    found, expected = contents(tmp_path / "out"), contents(tmp_path / "expected")
    assert found.keys() == expected.keys()
    assert len(found) == 20
    for name in found:
        if name.endswith(".npy"):  # another number of threads may round otherwise
            depths = [np.load(BytesIO(content[name])) for content in (found, expected)]
            np.testing.assert_allclose(*depths, rtol=1e-4)
        else:
            keys = [re.findall(rb'"(\w+)":', content[name]) for content in (found, expected)]
            assert keys[0] == keys[1]
    manifests = [{entry.input: entry.status for entry in entries(tmp_path / out / "zoedepth-manifest.jsonl")}
                 for out in ("out", "expected")]  # fmt: skip
    assert manifests[0] == manifests[1]
    # What is done needs no cluster.
    (folder / "bad.png").unlink()
    results, tally = on_ray(sources, tmp_path / "out", predictor, tell_done=True)
    assert (tally.before, tally.done) == (10, 0)
    assert all(done.before for done in results)


def test_exported_file_is_loaded_in_the_precision_that_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray", reason="the extra [ray] is not installed")
    asked: dict[str, object] = {}

    def load(name: str, **options: object) -> ExportedModel:
        asked.update(options, name=name)
        return load_exported(ASSETS / "zoed-lite.onnx")

    monkeypatch.setattr(ray_engine, "load_for_prediction", load)
    recipe = Recipe("model.xml", None, "cpu", "bfloat16", False, True, False, "none", None)
    with threads(1):
        assert recipe.predictor().precision == "bfloat16"
    assert asked == {"name": "model.xml", "device": "cpu", "precision": "bfloat16"}


def test_members_of_compressed_tar_files_are_refused(tmp_path: Path, tiny_model: ZoeDepth) -> None:
    pytest.importorskip("ray", reason="the extra [ray] is not installed")
    write_photo(tmp_path / "a.png")
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as archive:
        archive.add(tmp_path / "a.png", "a.png")
    with pytest.raises(InputError, match=r"unpack it to \.tar"):
        on_ray(Sources((str(tmp_path / "a.tar.gz"),)), tmp_path / "out", Predictor(tiny_model))


@pytest.mark.parametrize("n_failures", [2, 3])
def test_a_ray_of_a_busy_machine_is_started_again(
    tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, n_failures: int
) -> None:
    ray = pytest.importorskip("ray", reason="the extra [ray] is not installed")
    started: list[int] = []

    class Started(BaseException):
        pass

    def start(*_: object, **__: object) -> None:
        started.append(1)
        if len(started) > n_failures:
            raise Started
        raise Exception("The current node timed out during startup")

    monkeypatch.setattr(ray, "init", start)
    write_photo(tmp_path / "a.png")
    expected = (
        pytest.raises(Started) if n_failures < 3 else pytest.raises(InputError, match=r"Ray does not start .*timed out")
    )
    with expected:
        on_ray(Sources((str(tmp_path / "a.png"),)), tmp_path / "out", Predictor(tiny_model))
    assert len(started) == 3


@pytest.mark.parametrize("error", [ConnectionError, RuntimeError, ValueError])
@pytest.mark.parametrize(("address", "variable"), [("head:6379", "other:6379"), (None, "head:6379")])
def test_a_cluster_that_does_not_answer_is_named(
    tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, error: type[Exception],
    address: str | None, variable: str,
) -> None:  # fmt: skip
    ray = pytest.importorskip("ray", reason="the extra [ray] is not installed")
    asked: list[str] = []

    def connect(where: str, **_: object) -> None:
        asked.append(where)
        raise error("nobody is there")

    monkeypatch.setattr(ray, "init", connect)
    monkeypatch.setenv("RAY_ADDRESS", variable)
    write_photo(tmp_path / "a.png")
    message = r"^--address head:6379: no Ray cluster answers there \(nobody is there\)"
    with pytest.raises(InputError, match=message):
        on_ray(Sources((str(tmp_path / "a.png"),)), tmp_path / "out", Predictor(tiny_model), address=address)
    assert asked == ["head:6379"]
