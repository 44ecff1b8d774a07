"""The benchmark: who takes part, in what order, what is done with their failures, and what is chosen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.export.write import ExportError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.runtimes import benchmark as benchmarks
from zoedepth.runtimes.benchmark import EXAMPLES, Benchmark, benchmark, free_memory, measure, split
from zoedepth.runtimes.exports import find_source
from zoedepth.runtimes.machine import Machine
from zoedepth.runtimes.runtime import BASE, RUNTIMES
from zoedepth.runtimes.worker import Bench, Work
from zoedepth.weights.save import save_model

OPENVINO, BFLOAT16, INT8 = "OpenVINO, float32", "OpenVINO, bfloat16", "OpenVINO, int8"


@dataclass
class Said:
    """Numbers that a worker says, and the tasks that it fails at."""

    seconds: tuple[float, ...] = (1.0,)
    rate: float = 2.0
    memory: float | None = 100.0
    depth: float = 5.0
    fails_at: str | None = None


@dataclass
class Stage:
    """Workers that do nothing, and a record of who did what."""

    says: dict[str, Said] = field(default_factory=dict)
    events: list[tuple[str, str | None]] = field(default_factory=list)
    works: list[Work] = field(default_factory=list)
    open: int = 0

    def start(self, work: Work) -> "Actor":
        self.works.append(work)
        self.open += 1
        return Actor(self, work, self.says.get(work.runtime.name, Said()))


@dataclass
class Actor:
    stage: Stage
    work: Work
    said: Said
    n_photos: int = 0

    def ask(self, task: str | None) -> Any:
        self.stage.events.append((self.work.runtime.name, task))
        if self.said.fails_at == (task or "first"):
            raise InputError("the processor is on fire")
        if task == "one":
            self.n_photos += 1
            return self.said.seconds[(self.n_photos - 1) % len(self.said.seconds)]
        depths = [np.full((3, 4), self.said.depth, np.float32) for _ in self.work.photos]
        return {None: 0.5, "many": self.said.rate, "memory": (self.said.memory, None), "depths": depths}[task]

    def end(self) -> None:
        self.stage.open -= 1


def works(*names: str, at_once: int = 2) -> list[Work]:
    return [Work(RUNTIMES[name], Path("m"), (), True, (Path("a"), Path("b")), at_once) for name in names]


class TestMeasure:
    def test_a_row_has_medians_and_the_difference(self) -> None:
        stage = Stage({OPENVINO: Said((3.0, 1.0, 2.0), 4.0, 50.0, 5.05)})
        rows = measure(works(BASE.name, OPENVINO), repeats=3, start=stage.start)
        found = rows[OPENVINO]
        assert (found.seconds, found.least, found.most, found.photos_a_second) == (2.0, 1.0, 3.0, 4.0)
        assert (found.memory_mb, found.gpu_memory_mb, found.first_depth) == (50.0, None, 0.5)
        assert found.difference == pytest.approx(0.01, rel=1e-4)
        assert rows[BASE.name].difference == 0
        assert stage.open == 0

    def test_they_take_turns(self) -> None:
        stage = Stage()
        measure(works(BASE.name, OPENVINO), repeats=2, start=stage.start)
        for task, n_turns in (("one", 2), ("many", 1)):
            assert [name for name, what in stage.events if what == task] == n_turns * [BASE.name, OPENVINO]

    def test_one_core_needs_no_rate_of_its_own(self) -> None:
        stage = Stage({BASE.name: Said((0.25,))})
        rows = measure(works(BASE.name, at_once=1), repeats=1, start=stage.start)
        assert rows[BASE.name].photos_a_second == 4
        assert (BASE.name, "many") not in stage.events

    @pytest.mark.parametrize("task", ["first", "one", "many", "memory", "depths"])
    def test_one_that_fails_does_not_stop_the_others(self, task: str) -> None:
        stage = Stage({OPENVINO: Said(fails_at=task)})
        rows = measure(works(BASE.name, OPENVINO, BFLOAT16), repeats=1, start=stage.start)
        assert rows[OPENVINO].failed
        assert rows[OPENVINO].problem == "the processor is on fire"
        assert rows[OPENVINO].seconds is None
        assert rows[BASE.name].seconds == rows[BFLOAT16].seconds == 1.0
        assert stage.open == 0

    def test_depth_that_is_not_finite_has_failed(self) -> None:
        stage = Stage({OPENVINO: Said(depth=float("nan"))})
        assert "not finite" in measure(works(BASE.name, OPENVINO), repeats=1, start=stage.start)[OPENVINO].problem

    def test_without_the_first_there_is_nothing_to_compare_with(self) -> None:
        stage = Stage({BASE.name: Said(fails_at="one")})
        with pytest.raises(InputError, match="torch, float32, with which the others are compared, has failed"):
            measure(works(BASE.name, OPENVINO), repeats=1, start=stage.start)
        assert stage.open == 0

    def test_interruption_ends_all_workers(self) -> None:
        stage = Stage()

        def interrupt(text: str) -> None:
            if text.startswith("One photo"):
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            measure(works(BASE.name, OPENVINO), repeats=1, start=stage.start, tell=interrupt)
        assert len(stage.works) == 2
        assert stage.open == 0

    def test_interruption_ends_a_worker_that_has_only_begun(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def interrupt(self: Actor, task: str | None) -> None:
            raise KeyboardInterrupt

        stage = Stage()
        monkeypatch.setattr(Actor, "ask", interrupt)
        with pytest.raises(KeyboardInterrupt):
            measure(works(BASE.name), repeats=1, start=stage.start)
        assert (len(stage.works), stage.open) == (1, 0)

    @pytest.mark.parametrize(("free", "together"), [(None, 3), (151.0, 3), (149.0, 1)])
    def test_where_memory_is_short_one_goes_before_the_next_comes(self, free: float | None, together: int) -> None:
        stage, most = Stage(), 0

        def look() -> float | None:
            nonlocal most
            most = max(most, stage.open)
            return free

        rows = measure(
            works(BASE.name, OPENVINO, BFLOAT16), repeats=1, start=stage.start, free_memory_mb=look,
            tell=lambda text: look() and None,
        )  # fmt: skip
        assert most == together
        assert all(row.difference == 0 for row in rows.values())


class Here:
    """A worker that really measures, in this process."""

    def __init__(self, work: Work) -> None:
        self.work, self.bench = work, None

    def ask(self, task: Any) -> Any:
        if task is None:
            self.bench = Bench(self.work)
            return 0.1
        assert self.bench is not None
        return self.bench.do(task)

    def end(self) -> None:
        self.bench = None


@pytest.fixture
def nothing_exported(monkeypatch: pytest.MonkeyPatch, machine: Machine) -> list[tuple[str, tuple[Path, ...]]]:
    """Every runtime is installed, exports hold nothing, and the machine has no GPU; returns what was exported."""
    made: list[tuple[str, tuple[Path, ...]]] = []

    def export(source: object, runtime: Any, *, photos: Sequence[Path] = (), tell: Callable[[str], object]) -> Path:
        made.append((runtime.name, tuple(photos)))
        if runtime.name == BFLOAT16:
            raise InputError("the disk is full")
        if runtime.name == "ONNX Runtime, float32":
            raise ExportError("it gives other depth than torch")
        return Path(f"{runtime.name}.xml")

    monkeypatch.setattr(benchmarks, "exported_file", export)
    monkeypatch.setattr(benchmarks, "this_machine", lambda device: machine)
    monkeypatch.setattr("zoedepth.runtimes.runtime.find_spec", lambda module: object())
    return made


def by_name(result: Benchmark) -> dict[str, Any]:
    return {row.runtime: row for row in result.rows}


def test_table_and_choice(
    weights: Path, photos: list[Path], nothing_exported: list[tuple[str, tuple[Path, ...]]], machine: Machine
) -> None:
    stage = Stage(
        {OPENVINO: Said(rate=8.0, depth=5.02), INT8: Said(rate=20.0), "torch, bfloat16": Said(rate=9, depth=6)}
    )
    result = benchmark(weights, photos=photos, start=stage.start, repeats=1, compat=["squeeze"])
    assert [row.runtime for row in result.rows] == list(RUNTIMES)
    rows = by_name(result)
    assert (rows[BFLOAT16].problem, rows[BFLOAT16].failed) == ("the disk is full", True)
    onnx = rows["ONNX Runtime, float32"]
    assert (onnx.problem, onnx.failed) == ("it gives other depth than torch", False)  # an answer
    assert (rows["torch, float16, GPU"].problem, rows["torch, float16, GPU"].failed) == ("no GPU here", False)
    # Two photos: int8 was calibrated on those that it is compared on, and cannot be believed.
    assert rows[INT8].doubt
    assert result.choice.runtime == OPENVINO
    assert "8 photos a second" in result.choice.why
    assert result.choice.weights == find_source(weights, compat=["squeeze"]).weights
    assert (result.choice.machine, result.choice.rows) == (machine, result.rows)
    assert rows[OPENVINO].file == "OpenVINO, float32.xml"
    assert rows[BASE.name].file == result.choice.file == ""
    assert {work.compat for work in stage.works} == {("squeeze",)}
    assert {work.at_once for work in stage.works} == {2}


@pytest.mark.parametrize(("ratio", "problem"), [(0.29, "0.29 times as fast as in float32"), (0.31, "")])
def test_bfloat16_that_would_take_forever_is_not_measured(
    ratio: float,
    problem: str,
    weights: Path,
    photos: list[Path],
    nothing_exported: list[tuple[str, tuple[Path, ...]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(benchmarks, "products", lambda machine: {"float32": 100.0, "bfloat16": 100 * ratio})
    row = by_name(benchmark(weights, photos=photos, start=Stage().start, repeats=1))["torch, bfloat16"]
    assert problem in row.problem
    assert (row.failed, row.seconds is None) == (False, bool(problem))


def test_bfloat16_on_the_cpu_is_left_out_by_products_on_the_cpu_alone(
    weights: Path,
    photos: list[Path],
    machine: Machine,
    nothing_exported: list[tuple[str, tuple[Path, ...]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def measured(asked: Machine) -> dict[str, float]:
        return {"float32": 100.0, "bfloat16": 20.0 if asked.accelerator is None else 800.0}

    monkeypatch.setattr(benchmarks, "this_machine", lambda device: replace(machine, accelerator="H200"))
    monkeypatch.setattr(benchmarks, "products", measured)
    row = by_name(benchmark(weights, photos=photos, start=Stage().start, repeats=1))["torch, bfloat16"]
    assert "0.20 times as fast as in float32" in row.problem


def test_int8_is_chosen_where_it_was_calibrated_on_other_photos(
    weights: Path, photos: list[Path], nothing_exported: list[tuple[str, tuple[Path, ...]]]
) -> None:
    stage = Stage({INT8: Said(rate=20.0)})
    others = [photo.with_name(f"other-{photo.name}") for photo in photos]
    for photo, other in zip(photos, others, strict=True):
        other.write_bytes(photo.read_bytes() + b" ")
    given = [photos[0], others[0], photos[1], others[1]]
    result = benchmark(weights, photos=given, start=stage.start, repeats=1)
    assert (list(result.compared), list(result.calibrated)) == (photos, others)
    assert (INT8, tuple(others)) in nothing_exported
    assert (result.choice.runtime, result.choice.file) == (INT8, "OpenVINO, int8.xml")


def test_what_is_left_out_is_said(
    weights: Path, photos: list[Path], nothing_exported: list[tuple[str, tuple[Path, ...]]]
) -> None:
    stage = Stage()
    result = benchmark(weights, photos=photos, start=stage.start, repeats=1, int8=False, device="cpu", at_once=1)
    rows = by_name(result)
    assert rows[INT8].problem == rows["torch, float32, GPU"].problem == "left out"
    assert INT8 not in [name for name, _ in nothing_exported]


def test_torch_really_measures(weights: Path, photos: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the tiny model, in float32 and bfloat16."""
    monkeypatch.setattr("zoedepth.runtimes.runtime.find_spec", lambda module: None)
    told: list[str] = []
    result = benchmark(weights, photos=photos, start=Here, repeats=1, device="cpu", tell=told.append)
    rows = by_name(result)
    assert rows[BASE.name].difference == 0
    assert 0 < rows["torch, bfloat16"].difference < 0.5
    assert all(rows[name].first_depth == 0.1 for name in (BASE.name, "torch, bfloat16"))
    assert "pip install 'zoedepth[openvino]'" in rows[OPENVINO].problem
    assert told[0] == "First depth: torch, float32"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "model.onnx"}, "is an exported file"),
        ({"repeats": 0}, "repeats must be 1 or more"),
        ({"at_once": 0}, "at_once must be 1 or more"),
        ({"model": "no-such-model"}, "there is no model named"),
        ({"photos": [Path("none.jpg")]}, "none.jpg"),
    ],
)
def test_what_cannot_be_measured_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        benchmark(**{"start": Stage().start, **options})


def test_model_without_metres_is_refused(
    tiny_model: ZoeDepth, tmp_path: Path, photos: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoedepth.runtimes.runtime.find_spec", lambda module: None)
    bare = ZoeDepth(replace(tiny_model.config, domains=())).eval()
    save_model(bare, tmp_path / "bare.safetensors")
    with pytest.raises(InputError, match="gives relative depth"):
        benchmark(tmp_path / "bare.safetensors", photos=photos, start=Here, repeats=1, device="cpu")


@pytest.mark.parametrize("number", [1, 3, 4, 7, 16, 100, 1000])
def test_photos_are_split_into_those_to_compare_on_and_others(number: int) -> None:
    photos = [Path(str(each)) for each in range(number)]
    compared, calibrated = split(photos)
    assert 1 <= len(compared) <= 8
    assert 1 <= len(calibrated) <= 300
    assert compared[0] == photos[0]
    assert bool(set(compared) & set(calibrated)) == (number < 4)
    assert (len(compared) == 8) == (number >= 16)


def test_photos_of_the_package_are_there() -> None:
    assert all(photo.is_file() for photo in EXAMPLES)


def test_free_memory_is_read_where_the_system_tells_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "MEMINFO", tmp_path / "meminfo")
    assert free_memory() is None
    (tmp_path / "meminfo").write_text("MemTotal: 9 kB\nMemAvailable:  5000 kB\n")
    assert free_memory() == pytest.approx(5.12)
