"""Choices: the fastest that is close enough, and used for what it was made for only."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from zoedepth.errors import InputError
from zoedepth.runtimes.choice import Choice, Row, allowed_rel, fastest, read_choice, write_choice
from zoedepth.runtimes.machine import Machine

VERSIONS = {"zoedepth": "1", "openvino": None}


def row(name: str, rate: float | None, difference: float | None, **fields: Any) -> Row:
    return Row(name, 1.0, 1.0, 1.0, photos_a_second=rate, difference=difference, **fields)


BASE = row("torch, float32", 10.0, 0.0)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([BASE], "torch, float32"),
        ([BASE, row("a", 20.0, 0.009), row("b", 30.0, 0.011)], "a"),
        ([BASE, row("a", 20.0, 0.009), row("b", 19.8, 0.001)], "b"),  # as fast, and closer
        ([BASE, row("a", 20.0, 0.009), row("b", 18.0, 0.001)], "a"),
        ([BASE, row("a", 20.0, 0.0, doubt="of the same photos")], "torch, float32"),
        ([BASE, row("a", None, None, problem="not installed"), row("b", 20.0, None)], "torch, float32"),
        ([row("torch, float32", 10.0, 0.0), row("a", 9.0, 0.0)], "torch, float32"),
    ],
)
def test_the_fastest_that_is_close_enough(rows: list[Row], expected: str) -> None:
    assert fastest(rows).runtime == expected


def test_few_photos_say_little_of_others() -> None:
    rows = [BASE, row("a", 20.0, 0.009)]
    assert fastest(rows, max_rel=allowed_rel(8)).runtime == "a"
    assert fastest(rows, max_rel=allowed_rel(7)) == BASE


def test_nothing_to_choose_from_is_an_error() -> None:
    with pytest.raises(InputError, match="torch, float32: too little memory"):
        fastest([Row("torch, float32", problem="too little memory", failed=True)])


@pytest.fixture
def choice(machine: Machine) -> Choice:
    return Choice("torch, float32", "fastest", "00ff", machine, VERSIONS, "2026-01-31", rows=(BASE,))


def test_a_choice_is_read_as_it_was_written(choice: Choice, machine: Machine, cache: Path) -> None:
    path = write_choice(choice)
    assert path.is_relative_to(cache)
    assert read_choice("00ff", machine, VERSIONS) == choice
    write_choice(replace(choice, runtime="OpenVINO, float32"))
    again = read_choice("00ff", machine, VERSIONS)
    assert again is not None
    assert again.runtime == "OpenVINO, float32"


def test_it_holds_for_its_weights_machine_and_versions_only(choice: Choice, machine: Machine) -> None:
    path = write_choice(choice)
    assert read_choice("ffff", machine, VERSIONS) is None
    assert read_choice("00ff", replace(machine, cores=1), VERSIONS) is None
    assert read_choice("00ff", machine, {**VERSIONS, "openvino": "2026"}) is None
    # Not even if it lies where theirs would.
    values = json.loads(path.read_text())
    for changed in ({"weights": "ffff"}, {"machine": {**values["machine"], "cores": 1}}, {"versions": {}}):
        path.write_text(json.dumps({**values, **changed}))
        assert read_choice("00ff", machine, VERSIONS) is None


@pytest.mark.parametrize("damage", ["", "[]", "{}", "runtime", "rows", "machine"])
def test_damaged_choice_is_none(choice: Choice, machine: Machine, damage: str) -> None:
    path = write_choice(choice)
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, damage: "abacus"}) if damage in values else damage)
    assert read_choice("00ff", machine, VERSIONS) is None
