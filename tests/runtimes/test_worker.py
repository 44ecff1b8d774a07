"""Workers: what they measure, and that nothing which happens to their process is lost."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.batch import Outcome, Request
from zoedepth.errors import InputError
from zoedepth.photos import Photo
from zoedepth.predict import Predictor
from zoedepth.runtimes import worker as workers
from zoedepth.runtimes.runtime import BASE, Runtime
from zoedepth.runtimes.worker import KEPT, Bench, Process, Work, largest_rel, peak_memory_mb, thinned
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import ASSETS


def work(model: Path, photos: list[Path], runtime: Runtime = BASE, *, at_once: int = 2) -> Work:
    return Work(runtime, model, (), True, tuple(photos), at_once)


def test_photos_at_the_same_time_go_from_file_to_file(
    weights: Path, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    predict_photo = workers.predict_photo

    def noted(photo: Photo, predictor: Predictor, request: Request) -> Outcome:
        outcome = predict_photo(photo, predictor, request)
        written.append((photo.path, sorted(file.name for file in outcome.files.values() if file.stat().st_size)))
        return outcome

    monkeypatch.setattr(workers, "LONG_ENOUGH", 0)
    monkeypatch.setattr(workers, "predict_photo", noted)
    Bench(work(weights, photos)).do("many")
    assert sorted(written) == [(photos[0], [f"{number}.json", f"{number}_depth.png"]) for number in range(4)]


@pytest.mark.parametrize("at_once", [1, 2])
def test_bench_of_torch(weights: Path, photos: list[Path], at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "LONG_ENOUGH", 0)
    bench = Bench(work(weights, photos, at_once=at_once))
    assert bench.do("one") > 0
    assert bench.do("many") > 0
    assert bench.do("memory")[1] is None
    expected = Predictor(load_model(weights), camera="none")
    for found, photo in zip(bench.do("depths"), photos, strict=True):
        np.testing.assert_allclose(found, expected(photo).depth, rtol=1e-5)


def test_process_of_its_own_does_the_same(photos: list[Path]) -> None:
    """In ONNX Runtime, which starts quickly. Then its process is killed, as by a system that has no memory left."""
    process = Process(work(ASSETS / "zoed-lite.onnx", photos[:1], Runtime("ONNX Runtime", "float32")))
    try:
        assert process.ask(None) > 0
        assert process.ask("one") > 0
        assert process.ask("many") > 0
        memory, on_gpu = process.ask("memory")
        assert memory is None or memory > 10
        assert on_gpu is None
        (found,) = process.ask("depths")
        expected = Predictor(load_model(ASSETS / "zoed-lite.onnx"), camera="none")(photos[0]).depth
        np.testing.assert_allclose(found, expected, rtol=1e-4)
        process._process.terminate()
        with pytest.raises(InputError, match="ended by itself"):
            process.ask("one")
    finally:
        process.end()


def test_failure_in_the_process_is_told(tmp_path: Path, photos: list[Path]) -> None:
    process = Process(work(tmp_path / "none.safetensors", photos))
    try:
        with pytest.raises(InputError, match=r"none\.safetensors"):
            process.ask(None)
    finally:
        process.end()


def test_much_depth_is_thinned() -> None:
    depth = np.arange(1000 * 1500, dtype=np.float32).reshape(1000, 1500)
    thin = thinned(depth)
    assert thin.size <= KEPT
    assert thin[1, 1] == depth[3, 3]
    assert np.array_equal(thinned(depth[:100, :100]), depth[:100, :100])


def test_rel_is_that_of_the_worst_photo() -> None:
    expected = [np.full((2, 2), 2.0, np.float32), np.full((3, 1), 4.0, np.float32)]
    assert largest_rel(expected, expected) == 0
    assert largest_rel([expected[0] * 1.01, expected[1] * 0.9], expected) == pytest.approx(0.1, rel=1e-4)
    with pytest.raises(InputError, match="not finite"):
        largest_rel([expected[0] * np.nan, expected[1]], expected)


def test_memory_is_read_where_the_system_tells_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "STATUS", tmp_path / "status")
    (tmp_path / "status").write_text("Name: a\nVmHWM:\t  123000 kB\n")
    assert peak_memory_mb() == pytest.approx(125.952)
    (tmp_path / "status").write_text("Name: a\n")
    monkeypatch.setattr(workers.sys, "platform", "win32")
    assert peak_memory_mb() is None
