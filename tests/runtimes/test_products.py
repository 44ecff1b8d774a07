"""Products: measured once on a machine with one version of torch."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from zoedepth.runtimes import products as measured
from zoedepth.runtimes.machine import Machine
from zoedepth.runtimes.products import measure_products, products


class Meter:
    """Counts how often it measures."""

    def __init__(self) -> None:
        self.calls: list[bool] = []

    def __call__(self, on_gpu: bool) -> dict[str, float]:
        self.calls.append(on_gpu)
        return {"float32": 100.0, "bfloat16": 100.0 * len(self.calls)}


def test_what_was_measured_is_kept(machine: Machine) -> None:
    meter = Meter()
    first = products(machine, measure=meter)
    assert products(machine, measure=meter) == first == {"float32": 100.0, "bfloat16": 100.0}
    assert meter.calls == [False]
    products(replace(machine, accelerator="H200"), measure=meter)
    assert meter.calls == [False, True]


@pytest.mark.parametrize("damage", ["", "{}", "[1]", '{"float32": "fast"}', "version", "zero"])
def test_what_does_not_fit_is_measured_again(machine: Machine, cache: Path, damage: str) -> None:
    meter = Meter()
    products(machine, measure=meter)
    (path,) = (cache / "products").iterdir()
    kept = json.loads(path.read_text())
    changed = {"version": json.dumps({**kept, "torch": "1"}), "zero": json.dumps({**kept, "float32": 0})}
    path.write_text(changed.get(damage, damage))
    assert products(machine, measure=meter)["bfloat16"] == 200.0
    assert products(machine, measure=meter)["bfloat16"] == 200.0


def test_cache_that_cannot_be_written_is_no_reason_to_stop(machine: Machine, cache: Path) -> None:
    cache.mkdir(parents=True)
    (cache / "products").touch()  # a file where the folder would be
    assert products(machine, measure=Meter())["float32"] == 100.0


def test_rates_of_this_machine_are_positive(monkeypatch: pytest.MonkeyPatch) -> None:
    for side in ("ROWS", "INNER", "OUTER"):
        monkeypatch.setattr(measured, side, 16)
    rates = measure_products(False)
    assert rates.keys() == {"float32", "bfloat16"}
    assert min(rates.values()) > 0
