"""Machines: what speed depends on changes their fingerprint, on systems of every kind."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from zoedepth import __version__
from zoedepth.runtimes import machine as machines
from zoedepth.runtimes.machine import Machine, this_machine, versions

CPUINFO = """processor\t: 0
vendor_id\t: GenuineIntel
model name\t: Intel(R) Xeon(R) Processor
flags\t\t: avx512f {more}

processor\t: 1
model name\t: another
"""


@pytest.fixture(autouse=True)
def no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "has_accelerator", lambda: False)


def with_cpuinfo(text: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    path = tmp_path / "cpuinfo"
    if text is not None:
        path.write_text(text)
    monkeypatch.setattr(machines, "CPUINFO", path if text is not None else tmp_path / "none")
    return this_machine()


def test_processors_of_one_name_are_told_apart_by_their_instructions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = with_cpuinfo(CPUINFO.format(more=""), tmp_path, monkeypatch)
    tiles = with_cpuinfo(CPUINFO.format(more="amx_bf16"), tmp_path, monkeypatch)
    assert plain.processor == tiles.processor == "Intel(R) Xeon(R) Processor"
    assert plain.fingerprint != tiles.fingerprint
    assert with_cpuinfo(CPUINFO.format(more=""), tmp_path, monkeypatch) == plain


@pytest.mark.parametrize("text", [None, "", "what is this"])
def test_system_that_tells_nothing_has_a_machine_too(
    text: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = with_cpuinfo(text, tmp_path, monkeypatch)
    assert found.processor
    assert found.instructions == ""
    assert found.cores >= 1


@pytest.mark.parametrize("change", [{"cores": 3}, {"accelerator": "a GPU"}, {"processor": "b"}, {"instructions": "1"}])
def test_everything_is_in_the_fingerprint(machine: Machine, change: dict[str, object]) -> None:
    assert replace(machine, **change).fingerprint != machine.fingerprint


def test_people_read_it(machine: Machine) -> None:
    assert str(machine) == "A processor, 2 cores"
    assert str(replace(machine, cores=1, accelerator="a GPU")) == "A processor, 1 core, a GPU"


def test_gpu_is_told_by_torch_where_there_are_signs_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "has_accelerator", lambda: True)
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: False)
    assert this_machine().accelerator is None
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: True)
    monkeypatch.setattr(torch.accelerator, "current_accelerator", lambda: torch.device("cuda"))
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "H200")
    assert this_machine().accelerator == "H200"
    assert this_machine("cpu").accelerator is None


def test_versions_of_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "LIBRARIES", {"torch": ("torch",), "none": ("no-such-distribution",)})
    found = versions()
    assert found == {"zoedepth": __version__, "torch": found["torch"], "none": None}
    assert found["torch"]
