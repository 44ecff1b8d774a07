"""The fast way: what was measured is taken, what was not is decided by what is known, and the depth is right."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoedepth.errors import FullDiskError, InputError
from zoedepth.export.write import ExportError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.runtimes import fast as fasts
from zoedepth.runtimes.choice import Choice, read_choice, write_choice
from zoedepth.runtimes.exports import find_source
from zoedepth.runtimes.fast import Fast, compare_predictors, decide, load_fast, order
from zoedepth.runtimes.machine import Machine, versions
from zoedepth.runtimes.runtime import Runtime
from zoedepth.runtimes.worker import largest_rel
from zoedepth.threads import thread_count, threads
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import ASSETS

SLOW, QUICK = {"float32": 100.0, "bfloat16": 60.0}, {"float32": 100.0, "bfloat16": 210.0}


@pytest.fixture(autouse=True)
def here(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """The machine is always the same, bfloat16 is slow on it, and nothing but torch is installed."""
    monkeypatch.setattr(fasts, "this_machine", lambda device: machine)
    monkeypatch.setattr("zoedepth.runtimes.products.measure_products", lambda on_gpu: SLOW)
    monkeypatch.setattr("zoedepth.runtimes.runtime.find_spec", lambda module: None)
    return machine


@pytest.fixture
def exported(monkeypatch: pytest.MonkeyPatch, tiny_model: ZoeDepth) -> dict[str, Any]:
    """Every runtime is installed, and loads the tiny model; "error" is what exporting raises."""
    about: dict[str, Any] = {"error": None, "streams": [], "keep": []}

    def export(source: object, runtime: Runtime, *, tell: object) -> Path:
        if about["error"] is not None:
            raise about["error"]
        return Path("model.xml")

    def load(
        self: Runtime, model: Path, *, compat: object = (), streams: int = 1, keep: Path | None = None
    ) -> ZoeDepth:
        about["streams"].append(streams)
        about["keep"].append(keep)
        return tiny_model

    monkeypatch.setattr("zoedepth.runtimes.runtime.find_spec", lambda module: object())
    monkeypatch.setattr(fasts, "exported_file", export)
    monkeypatch.setattr(Runtime, "load", load)
    return about


def chosen(weights: Path, machine: Machine, runtime: str, **fields: Any) -> Choice:
    """Write down that a runtime was chosen for these weights."""
    choice = Choice(runtime, "measured", find_source(weights).weights, machine, versions(), "2026-01-31", **fields)
    write_choice(choice)
    return choice


class TestLoadFast:
    def test_what_was_measured_is_taken(self, weights: Path, here: Machine, exported: dict[str, Any]) -> None:
        chosen(weights, here, "OpenVINO, bfloat16")
        found = load_fast(weights, streams=3)
        assert (found.runtime, found.why) == ("OpenVINO, bfloat16", "measured")
        # The file computes in bfloat16 by itself: torch, which is what the predictor asks, has no part in it.
        assert (found.precision, found.device) == ("float32", "cpu")
        assert exported["streams"] == [3]
        # Beside the exported file, with which it goes: another version has another folder, as another machine has.
        assert exported["keep"] == [Path(f"compiled-{here.fingerprint}")]

    def test_torch_in_bfloat16_is_told_to_the_predictor(self, weights: Path, here: Machine, photos: list[Path]) -> None:
        chosen(weights, here, "torch, bfloat16")
        found = load_fast(weights)
        predictor = Predictor(found.model, precision=found.precision, device=found.device)
        assert predictor.runtime == found.runtime == "torch, bfloat16"
        assert np.isfinite(predictor(photos[0]).depth).all()

    @pytest.mark.parametrize("other", ["weights", "machine", "versions"])
    def test_what_was_measured_for_others_is_not_used(self, weights: Path, here: Machine, other: str) -> None:
        choice = chosen(weights, here, "torch, bfloat16")
        changed = {
            "weights": {"weights": "ffff"}, "machine": {"machine": replace(here, instructions="amx")},
            "versions": {"versions": {**versions(), "torch": "1"}},
        }  # fmt: skip
        write_choice(choice).unlink()
        write_choice(replace(choice, **changed[other]))
        assert load_fast(weights).runtime == "torch, float32"

    def test_decision_is_written_down_and_holds(
        self, weights: Path, here: Machine, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        first = load_fast(weights)
        assert (first.runtime, first.precision) == ("torch, float32", "float32")
        assert "0.60 times as fast as in float32" in first.why
        monkeypatch.setattr(fasts, "decide", lambda *_, **__: pytest.fail("it was decided again"))
        assert load_fast(weights).why == first.why

    def test_cache_that_cannot_be_written_is_no_reason_to_stop(
        self, weights: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        def refuse(choice: Choice) -> Path:
            raise PermissionError("read-only")

        monkeypatch.setattr(fasts, "write_choice", refuse)
        assert load_fast(weights).runtime == "torch, float32"
        assert "read-only" in caplog.text

    @pytest.mark.parametrize("error", [InputError("no room"), OSError("no disk"), ExportError("other depth")])
    def test_export_that_fails_now_leaves_torch(
        self, error: Exception, weights: Path, here: Machine, exported: dict[str, Any]
    ) -> None:
        chosen(weights, here, "OpenVINO, bfloat16")
        exported["error"] = error
        found = load_fast(weights)
        assert found.runtime == "torch, float32"
        assert str(error) in found.why
        assert "OpenVINO, bfloat16" in found.why

    def test_int8_runs_the_file_that_was_measured_or_something_else_is_chosen(
        self, weights: Path, here: Machine, exported: dict[str, Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its photos are not known here, so that it cannot be exported again."""
        choice = chosen(weights, here, "OpenVINO, int8", file=str(weights.with_name("gone.xml")))
        again = replace(choice, runtime="OpenVINO, float32", file="")
        monkeypatch.setattr(fasts, "decide", lambda *_, **__: (again, True))
        assert load_fast(weights).runtime == "OpenVINO, float32"
        assert read_choice(choice.weights, here, versions()) == again

    def test_relative_depth_and_named_devices_stay_with_torch(
        self, weights: Path, here: Machine, exported: dict[str, Any]
    ) -> None:
        chosen(weights, here, "OpenVINO, bfloat16")
        relative = load_fast(weights, metres=False)
        assert (relative.runtime, relative.precision, relative.device) == ("torch, float32", "float32", "auto")
        assert (load_fast(weights, device="cuda").runtime, load_fast(weights, device="cuda").device) == (
            "torch, float32", "cuda",
        )  # fmt: skip

    def test_gpu_that_was_measured_is_taken(
        self, weights: Path, here: Machine, exported: dict[str, Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        machine = replace(here, accelerator="H200")
        monkeypatch.setattr(fasts, "this_machine", lambda device: machine)
        chosen(weights, machine, "torch, float16, GPU")
        found = load_fast(weights, device="cuda")
        assert (found.runtime, found.precision, found.device) == ("torch, float16, GPU", "float16", "cuda")
        chosen(weights, machine, "OpenVINO, float32")
        assert load_fast(weights, device="cuda").runtime == "torch, float32"
        assert load_fast(weights).runtime == "OpenVINO, float32"

    def test_exported_file_runs_in_its_own_runtime(self) -> None:
        found = load_fast(ASSETS / "zoed-lite.onnx")
        assert (found.runtime, found.precision) == ("ONNX Runtime, float32", "float32")
        with pytest.raises(InputError, match="built in"):
            load_fast(ASSETS / "zoed-lite.onnx", compat=["squeeze"])


class TestDecide:
    def test_order_is_that_of_the_table(self) -> None:
        assert order(packaged=True) == ("OpenVINO", "ONNX Runtime", "torch")
        assert order(packaged=False) == ("OpenVINO", "torch")

    @pytest.mark.parametrize(
        ("rates", "rel", "times", "expected"),
        [
            (SLOW, 0.0, 9.0, "OpenVINO, float32"),  # not even tried
            (QUICK, 0.002, 1.5, "OpenVINO, bfloat16"),
            (QUICK, 0.006, 1.5, "OpenVINO, float32"),
            (QUICK, 0.002, 1.05, "OpenVINO, float32"),
            (QUICK, float("inf"), 2.0, "OpenVINO, float32"),
        ],
    )
    def test_bfloat16_only_where_it_is_fast_and_right(
        self,
        rates: dict[str, float],
        rel: float,
        times: float,
        expected: str,
        weights: Path,
        here: Machine,
        exported: dict[str, Any],
    ) -> None:
        compared = []

        def compare(base: Predictor, other: Predictor) -> tuple[float, float]:
            compared.append((base, other))
            return rel, times

        choice, lasting = decide(find_source(weights), here, measure=lambda on_gpu: rates, compare=compare)
        assert (choice.runtime, lasting) == (expected, True)
        assert len(compared) == (rates is QUICK)
        assert "docs/performance.md" in choice.why

    @pytest.mark.parametrize(
        ("error", "lasting"),
        [
            (FullDiskError("no room"), False),
            (OSError("no rights"), False),
            (InputError("NeWCRFs cuts a photo into windows"), True),
            (ExportError("other"), True),
        ],
    )
    def test_runtime_that_cannot_hold_the_model_is_left_out(
        self, error: Exception, lasting: bool, weights: Path, here: Machine, exported: dict[str, Any]
    ) -> None:
        exported["error"] = error
        choice, holds = decide(find_source(weights), here, measure=lambda on_gpu: SLOW)
        assert choice.runtime == "torch, float32"
        assert f"OpenVINO was left out: {error}" in choice.why
        assert holds == lasting

    def test_bfloat16_that_the_processor_has_not_is_left_out(
        self, weights: Path, here: Machine, exported: dict[str, Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("zoedepth.runtimes.runtime.has_bfloat16", lambda: False)
        choice, holds = decide(find_source(weights), here, measure=lambda on_gpu: QUICK)
        assert (choice.runtime, holds) == ("OpenVINO, float32", True)
        assert "OpenVINO, bfloat16 was left out: this processor has no bfloat16" in choice.why

    def test_comparison_that_fails_is_no_bfloat16(self, weights: Path, here: Machine, exported: dict[str, Any]) -> None:
        def fail(base: Predictor, other: Predictor) -> tuple[float, float]:
            raise InputError("no memory")

        choice, holds = decide(find_source(weights), here, measure=lambda on_gpu: QUICK, compare=fail)
        assert (choice.runtime, holds) == ("OpenVINO, float32", False)
        assert "no memory" in choice.why

    def test_all_cores_measure_whatever_share_a_photo_has(
        self, weights: Path, here: Machine, exported: dict[str, Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(fasts, "cpu_count", lambda: 3)
        found: list[int] = []

        def measure(on_gpu: bool) -> dict[str, float]:
            found.append(thread_count())
            return QUICK

        def compare(base: Predictor, other: Predictor) -> tuple[float, float]:
            found.append(thread_count())
            return 0.0, 2.0

        with threads(1):
            decide(find_source(weights), here, measure=measure, compare=compare)
            found.append(thread_count())
        assert found == [3, 3, 1]

    def test_gpu_comes_first(self, weights: Path, here: Machine, exported: dict[str, Any]) -> None:
        machine = replace(here, accelerator="H200")
        choice, _ = decide(find_source(weights), machine, measure=lambda on_gpu: SLOW if on_gpu else QUICK)
        assert choice.runtime == "torch, float32, GPU"


def test_model_of_the_package_is_fast_without_an_export_and_right(
    here: Machine, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In ONNX Runtime, where OpenVINO is not installed."""
    monkeypatch.setattr(
        "zoedepth.runtimes.runtime.find_spec", lambda module: object() if module == "onnxruntime" else None
    )
    found = load_fast("zoed-lite")
    assert isinstance(found, Fast)
    assert found.runtime == "ONNX Runtime, float32"
    assert read_choice(find_source("zoed-lite").weights, here, versions()) is not None
    depth = Predictor(found.model, precision=found.precision, device=found.device)(photos[0]).depth
    np.testing.assert_allclose(depth, Predictor(load_model("zoed-lite"))(photos[0]).depth, rtol=1e-3)


def test_predictors_are_compared_on_the_photos_of_the_package(
    tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, photos: list[Path]
) -> None:
    monkeypatch.setattr(fasts, "EXAMPLES", tuple(photos))
    base, other = Predictor(tiny_model), Predictor(tiny_model, flip_average=False)
    rel, times = compare_predictors(base, other)
    expected = [np.mean(np.abs(other(photo).depth / base(photo).depth - 1)) for photo in photos]
    assert rel == pytest.approx(max(expected), rel=1e-4)
    assert times > 0
    monkeypatch.setattr(fasts, "largest_rel", lambda depths, base: largest_rel([x * np.nan for x in depths], base))
    assert compare_predictors(base, other)[0] == float("inf")
