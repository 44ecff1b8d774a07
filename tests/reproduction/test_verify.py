"""The released weights on the official data: what is found, what is missing, and the difference to the paper."""

import shutil
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.reproduction.released import write_released

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.evaluation.evaluation_set import EvaluationSet, open_evaluation_set
from zoedepth.evaluation.protocols import PROTOCOLS, Protocol
from zoedepth.reproduction import verify as module
from zoedepth.reproduction.verify import Difference, difference_table, find_files, verify
from zoedepth.weights.releases import RELEASES


@pytest.fixture
def folder(tmp_path: Path, tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Weights of one model (a tiny one), and photos that stand for NYU; nothing is in the user's cache."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "no-cache"))
    write_released(tmp_path / "files", tiny_config)
    return tmp_path / "files"


def test_what_is_there_is_found_and_what_is_not_is_said(folder: Path) -> None:
    found = find_files(folder)
    assert found.weights == {"zoed-m12-n": str(folder / "weights" / "zoed-m12-n.safetensors")}
    assert found.data == {"nyu": folder / "nyu"}
    assert found.missing.keys() == {
        "zoed-m12-k", "zoed-m12-nk", "sunrgbd", "ibims", "diode-indoor", "hypersim", "kitti", "vkitti2", "ddad",
        "diml-outdoor", "diode-outdoor",
    }  # fmt: skip
    assert "ZoeD_M12_NK.pt" in found.missing["zoed-m12-nk"]
    assert str(folder / "kitti") in found.missing["kitti"]
    assert find_files(folder, download=True).weights.keys() == {"zoed-m12-n", "zoed-m12-k", "zoed-m12-nk"}
    (folder / RELEASES["zoed-m12-k"].file).touch()
    assert find_files(folder).weights["zoed-m12-k"] == str(folder / "ZoeD_M12_K.pt")
    with pytest.raises(InputError, match="there is no folder"):
        find_files(folder / "none")


def test_both_protocols_are_measured_and_compared_with_what_is_printed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[str, str]] = []

    def open_set(source: Path, *, name: str, protocol: Protocol) -> EvaluationSet:
        opened.append((name, protocol.name))
        return open_evaluation_set(source, name=name, protocol=protocol)

    monkeypatch.setattr(module, "open_evaluation_set", open_set)
    found = find_files(folder)
    rows = verify(found, out=tmp_path / "out")
    assert opened == [("nyu", "nyu"), ("nyu", "nyu-released")]
    measured = [row for row in rows if row.measured]
    assert [(row.model, row.data, row.metric, str(row.printed)) for row in measured] == [
        ("ZoeD-M12-N", "nyu", "rel", "0.075"), ("ZoeD-M12-N", "nyu", "rmse", "0.270"),
        ("ZoeD-M12-N", "nyu", "delta1", "0.955"),
    ]  # fmt: skip
    assert all(row.measured.keys() == {"paper", "released"} for row in measured)
    assert PROTOCOLS["nyu"].hash == PROTOCOLS["nyu-released"].hash  # so the numbers are the same
    assert measured[0].measured["paper"] == measured[0].measured["released"]
    assert "has 2 photos to score, the paper 654" in found.missing["nyu"]
    others = {(row.model, row.data) for row in rows if not row.measured}
    assert ("ZoeD-M12-K", "vkitti2") in others
    assert ("ZoeD-M12-NK", "nyu") in others


def test_a_model_is_loaded_once_and_no_photo_is_scored_twice_under_the_same_protocol(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(folder / "nyu", folder / "ibims")
    loaded, scored = [], []
    load = module.ModelSource.load
    monkeypatch.setattr(module.ModelSource, "load", lambda name, **rest: loaded.append(name) or load(name, **rest))

    def evaluate(sources: object, sets: dict[str, EvaluationSet], **_: object) -> SimpleNamespace:
        scored.extend(sets)
        return SimpleNamespace(summaries=[])

    monkeypatch.setattr(module, "evaluate", evaluate)
    monkeypatch.setattr(module, "open_evaluation_set", lambda *_, **__: SimpleNamespace(dataset=[]))
    verify(find_files(folder), out=tmp_path / "out")
    assert loaded == [str(folder / "weights" / "zoed-m12-n.safetensors")]
    assert scored == ["nyu", "ibims-released", "ibims"]


def test_data_that_cannot_be_opened_is_said_and_the_rest_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "ibims").mkdir()  # empty
    monkeypatch.setattr(module, "evaluate", lambda *_, **__: SimpleNamespace(summaries=[]))
    found = find_files(folder)
    verify(found, out=tmp_path / "out")
    assert "ibims" in found.missing


def test_table_has_the_differences() -> None:
    rows = [
        Difference("ZoeD-M12-N", "nyu", "rel", Decimal("0.075"), {"paper": 0.0765, "released": 0.0749}),
        Difference("ZoeD-M12-K", "ddad", "rmse", Decimal("7.108"), {}),
    ]
    assert difference_table(rows).rows == (
        ("ZoeD-M12-N", "nyu", "REL", "0.075", "0.0765", "+0.0015", "0.0749", "-0.0001"),
        ("ZoeD-M12-K", "ddad", "RMSE (m)", "7.108", "not run", "-", "not run", "-"),
    )
