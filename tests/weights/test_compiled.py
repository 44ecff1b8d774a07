"""Compiled graphs of OpenVINO that are kept: a second start compiles nothing, and what is damaged is made again."""

import logging
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openvino
import pytest
from tests.weights.test_exported import attractors_file

from zoedepth.weights import compiled
from zoedepth.weights.exported import OpenVinoModel, load_exported
from zoedepth.weights.openvino_processor import UNMERGED
from zoedepth.weights.tensors import INPUT


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return attractors_file(tmp_path / "model.xml", 6)


@pytest.fixture
def compiles(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The graphs that were compiled, by the height of their pixels."""
    compile_model, heights = openvino.Core.compile_model, list[str]()

    def count(core: Any, graph: Any, device: str, properties: dict[str, Any]) -> Any:
        done = compile_model(core, graph, device, properties)
        heights.append(str(graph.input(INPUT).get_partial_shape()[2]))
        return done

    monkeypatch.setattr(openvino.Core, "compile_model", count)
    return heights


def loaded(path: Path, *, keep: Path | None, streams: int = 1) -> OpenVinoModel:
    model = load_exported(path, keep=keep, streams=streams)
    assert isinstance(model, OpenVinoModel)
    return model


def depth(model: OpenVinoModel, height: int = 64, *, std: bool = False) -> np.ndarray:
    pixels = np.random.default_rng(height).random((1, 3, height, 32), dtype=np.float32)
    return model.run({INPUT: pixels}, std=std)["predicted_depth"]


def test_second_start_compiles_nothing(model: Path, tmp_path: Path, compiles: list[str]) -> None:
    keep = tmp_path / "kept"
    first = depth(loaded(model, keep=keep))
    second = loaded(model, keep=keep, streams=2)
    assert np.allclose(depth(second), first, rtol=1e-5)
    assert compiles == ["64"]
    (graph,) = second.compiled.values()
    assert graph.get_property("NUM_STREAMS") == 2
    assert np.allclose(depth(pickle.loads(pickle.dumps(second))), first, rtol=1e-5)
    assert compiles == ["64"]


def test_nothing_is_kept_unless_a_folder_is_given(model: Path, tmp_path: Path, compiles: list[str]) -> None:
    before = sorted(tmp_path.rglob("*"))
    for _ in range(2):
        depth(loaded(model, keep=None))
    assert compiles == ["64", "64"]
    assert sorted(tmp_path.rglob("*")) == before


def test_every_kind_of_graph_is_kept_by_itself(model: Path, tmp_path: Path, compiles: list[str]) -> None:
    """Of a second shape, the graph for all shapes is compiled, which is not kept."""
    keep = tmp_path / "kept"
    for _ in range(2):
        first = loaded(model, keep=keep)
        depth(first)
        depth(first, std=True)
        depth(first, 96)
        depth(loaded(model, keep=keep), 96)
    assert len(list(keep.iterdir())) == 3
    assert compiles == ["64", "64", "?", "96", "?"]


def test_graph_of_other_weights_is_compiled_again(model: Path, tmp_path: Path, compiles: list[str]) -> None:
    """Exported anew over the same file, and of another file."""
    keep = tmp_path / "kept"
    before = depth(loaded(model, keep=keep))
    attractors_file(model, 2)
    expected = depth(loaded(model, keep=None))
    assert not np.allclose(expected, before, rtol=1e-3)
    assert np.allclose(depth(loaded(model, keep=keep)), expected, rtol=1e-5)
    other = attractors_file(tmp_path / "other.xml", 6)
    assert np.allclose(depth(loaded(other, keep=keep)), before, rtol=1e-5)
    assert len(compiles) == 4


def test_graph_of_another_version_of_openvino_is_compiled_again(
    model: Path, tmp_path: Path, compiles: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    depth(loaded(model, keep=tmp_path / "kept"))
    monkeypatch.setattr(openvino, "__version__", "1999.1")
    depth(loaded(model, keep=tmp_path / "kept"))
    assert len(compiles) == 2


def test_those_used_last_are_kept(model: Path, tmp_path: Path, compiles: list[str]) -> None:
    keep, heights = tmp_path / "kept", [32, 64, 96]
    for place, height in enumerate(heights):
        depth(loaded(model, keep=keep), height)
        for file in keep.iterdir():  # the files are older than their times say, so that each use is later
            os.utime(file, (file.stat().st_atime, file.stat().st_mtime - 100 * (3 - place)))
    depth(loaded(model, keep=keep), 32)  # used again
    depth(loaded(model, keep=keep), 128)  # one too many
    compiles.clear()
    for height in (32, 96, 128, 64):
        depth(loaded(model, keep=keep), height)
    assert compiles == ["64"]
    assert len(list(keep.iterdir())) == compiled.MOST


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-1],
        lambda content: content[:100],
        lambda content: b"",
        lambda content: b"[1]" + b" " * len(content),
        lambda content: b"\xff" * len(content),
    ],
    ids=["cut", "head", "empty", "list", "noise"],
)
def test_damaged_file_is_made_again(
    damage: Callable[[bytes], bytes], model: Path, tmp_path: Path, compiles: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    keep = tmp_path / "kept"
    first = depth(loaded(model, keep=keep))
    (file,) = keep.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert np.allclose(depth(loaded(model, keep=keep)), first, rtol=1e-5)
    assert f"{file} cannot be used" in caplog.text
    assert np.allclose(depth(loaded(model, keep=keep)), first, rtol=1e-5)
    assert compiles == ["64", "64"]


def test_graph_that_openvino_does_not_take_is_compiled(
    model: Path, tmp_path: Path, compiles: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    keep = tmp_path / "kept"
    first = depth(loaded(model, keep=keep))

    def refuse(*args: object) -> Any:
        raise RuntimeError("the blob is of another version")

    monkeypatch.setattr(openvino.Core, "import_model", refuse)
    assert np.allclose(depth(loaded(model, keep=keep)), first, rtol=1e-5)
    assert compiles == ["64", "64"]


def test_folder_that_cannot_be_written_to_is_no_reason_to_stop(
    model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keep = tmp_path / "kept"
    keep.touch()  # a file where the folder would be
    with caplog.at_level(logging.WARNING):
        assert depth(loaded(model, keep=keep)).size
    assert "was not kept" in caplog.text


def test_graph_without_merging_is_read_without(
    model: Path, tmp_path: Path, compiles: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read with merging, it would meet the same limit again."""
    keep = tmp_path / "kept"
    first = loaded(model, keep=keep)
    first.properties |= UNMERGED
    expected = depth(first)
    import_model, seen = openvino.Core.import_model, list[str]()

    def note(core: Any, tensor: Any, device: str, properties: dict[str, Any]) -> Any:
        seen.append(properties["SNIPPETS_MODE"])
        return import_model(core, tensor, device, properties)

    monkeypatch.setattr(openvino.Core, "import_model", note)
    assert np.allclose(depth(loaded(model, keep=keep)), expected, rtol=1e-5)
    assert (seen, compiles) == (["DISABLE"], ["64"])
