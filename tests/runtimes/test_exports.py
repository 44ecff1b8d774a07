"""Exported files in the cache: made once, whole, and again when anything that they depend on has changed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.models import flat

import zoedepth.export.write
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.export.write import ExportError
from zoedepth.predict import Predictor
from zoedepth.runtimes import exports
from zoedepth.runtimes.exports import exported_file, find_source, packaged_graph
from zoedepth.runtimes.runtime import RUNTIMES
from zoedepth.weights.releases import ASSETS

ONNX, OPENVINO, INT8 = (RUNTIMES[name] for name in ("ONNX Runtime, float32", "OpenVINO, float32", "OpenVINO, int8"))


class Exporter:
    """Writes files that hold nothing, and keeps how it was called."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, bool, list[Path]]] = []
        self.error: Exception | BaseException | None = None

    def __call__(
        self, model: Any, path: Path, *, to: str, int8: bool, photos: Sequence[Path], accuracy_control: bool
    ) -> float:
        assert not accuracy_control
        self.calls.append((to, int8, list(photos)))
        path.parent.mkdir(parents=True)
        path.with_suffix(".bin").write_text("weights")
        if self.error is not None:
            raise self.error
        path.write_text("graph")
        return 0.0


@pytest.fixture
def exporter(monkeypatch: pytest.MonkeyPatch) -> Exporter:
    exporter = Exporter()
    monkeypatch.setattr(zoedepth.export.write, "export_model", exporter)
    return exporter


def files(cache: Path) -> list[str]:
    """Return the files in the cache, without locks."""
    found = (path for path in cache.rglob("*") if path.is_file() and path.suffix != ".lock")
    return sorted(path.name for path in found)


def test_file_is_made_once(weights: Path, cache: Path, exporter: Exporter) -> None:
    source, told = find_source(weights), list[str]()
    file = exported_file(source, OPENVINO, tell=told.append)
    assert exported_file(source, OPENVINO, tell=told.append) == file
    assert exporter.calls == [("openvino", False, [])]
    assert len(told) == 1
    assert str(file.parent) in told[0]
    assert files(cache) == ["model.bin", "model.xml"]


@pytest.mark.parametrize("library", ["zoedepth", "torch", "openvino"])
def test_other_versions_make_it_again_and_the_old_one_goes(
    library: str, weights: Path, cache: Path, exporter: Exporter, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, found = find_source(weights), exports.versions()
    exported_file(source, INT8, photos=[weights])
    before = exported_file(source, OPENVINO)
    monkeypatch.setattr(exports, "versions", lambda: {**found, library: "next"})
    after = exported_file(source, OPENVINO)
    assert after != before
    assert not before.exists()
    assert len(exporter.calls) == 3
    assert files(cache) == 2 * ["model.bin"] + 2 * ["model.xml"]  # that of int8 is another kind
    exported_file(source, INT8, photos=[weights])
    assert files(cache) == 2 * ["model.bin"] + 2 * ["model.xml"]


def test_libraries_that_have_no_part_in_a_file_do_not_matter(
    weights: Path, exporter: Exporter, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, found = find_source(weights), exports.versions()
    file = exported_file(source, ONNX)
    monkeypatch.setattr(exports, "versions", lambda: {**found, "openvino": "next", "nncf": "next"})
    assert exported_file(source, ONNX) == file


def test_weights_and_behaviours_have_files_of_their_own(weights: Path, exporter: Exporter) -> None:
    plain = find_source(weights)
    assert find_source(weights, compat=["squeeze", "10m"]) == find_source(weights, compat=("10m", "squeeze"))
    assert find_source(weights, compat=["squeeze"]).weights != plain.weights
    other = weights.with_name("other.safetensors")
    other.write_bytes(weights.read_bytes() + b"1")
    assert find_source(other).weights != plain.weights


def test_photos_of_the_calibration_count_by_their_content(
    weights: Path, photos: list[Path], exporter: Exporter
) -> None:
    source = find_source(weights)
    first = exported_file(source, INT8, photos=photos)
    moved = [photo.rename(photo.with_name(f"moved-{photo.name}")) for photo in photos]
    assert exported_file(source, INT8, photos=moved) == first
    assert exported_file(source, INT8, photos=moved[:1]) != first
    assert first.is_file(), "another choice may point to it"
    assert [call[1:] for call in exporter.calls] == [(True, photos), (True, moved[:1])]


@pytest.mark.parametrize("error", [ExportError("other depth"), InputError("no room"), KeyboardInterrupt()])
def test_nothing_is_left_of_an_export_that_ends_early(
    error: BaseException, weights: Path, cache: Path, exporter: Exporter
) -> None:
    exporter.error = error
    with pytest.raises(type(error)):
        exported_file(find_source(weights), OPENVINO)
    assert files(cache) == []
    exporter.error = None
    assert exported_file(find_source(weights), OPENVINO).is_file()


def test_what_a_killed_process_has_left_is_removed(weights: Path, cache: Path, exporter: Exporter) -> None:
    file = exported_file(find_source(weights), OPENVINO)
    file.parent.rename(file.parent.with_name(f".{file.parent.name}"))  # as far as it came
    assert exported_file(find_source(weights), OPENVINO).is_file()
    assert files(cache) == ["model.bin", "model.xml"]


def test_graph_of_the_package_is_taken_as_it_is(cache: Path, exporter: Exporter) -> None:
    source = find_source("zoed-lite")
    assert exported_file(source, ONNX) == packaged_graph(source) == ASSETS / "zoed-lite.onnx"
    assert exporter.calls == files(cache) == []
    assert packaged_graph(find_source("zoed-lite", compat=["squeeze"])) is None


def test_a_file_is_what_its_runtime_runs(
    weights: Path, photos: list[Path], tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the real export, of a model that takes little time, in ONNX Runtime, which takes least."""
    model, runtime = flat(replace(tiny_config, head=replace(tiny_config.head, n_attractors=(1, 1, 1, 1))), 1), ONNX
    monkeypatch.setattr(exports, "load_network", lambda *_, **__: model)
    found = Predictor(runtime.load(exported_file(find_source(weights), runtime)), flip_average=False)
    expected = Predictor(model, flip_average=False)
    assert np.abs(found(photos[0]).depth / expected(photos[0]).depth - 1).max() < 1e-3
