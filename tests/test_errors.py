"""One family of exceptions, which are also the built-in ones that callers know."""

import pickle
import re
from importlib.metadata import requires

import pytest

from zoedepth.errors import (
    OPTIONAL,
    InputError,
    MissingExtraError,
    TrainingError,
    ZoeDepthError,
    first_line,
    is_no_memory,
    no_such,
    similar,
)


@pytest.mark.parametrize(
    ("kind", "builtin"), [(InputError, ValueError), (TrainingError, Exception), (MissingExtraError, ImportError)]
)
def test_one_family(kind: type[Exception], builtin: type[Exception]) -> None:
    assert issubclass(kind, ZoeDepthError)
    assert issubclass(kind, builtin)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("CUDA out of memory. Tried to allocate 2 GiB"),
        RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory: you tried"),
        RuntimeError("[ONNXRuntimeError] : 6 : Failed to allocate memory for requested buffer of size 400"),
        RuntimeError("std::bad_alloc"),
        OSError(12, "Cannot allocate memory"),
    ],
)
def test_too_little_memory_is_known_by_the_words_of_every_library(error: Exception) -> None:
    assert is_no_memory(error)


@pytest.mark.parametrize(
    "error", [InputError("out of memory.png is damaged"), RuntimeError("Can't allocate registers")]
)
def test_other_errors_are_not_taken_for_too_little_memory(error: Exception) -> None:
    assert not is_no_memory(error)


def test_the_first_line_of_an_error_is_short_and_never_empty() -> None:
    assert first_line(ValueError("\none\ntwo")) == "one"
    assert first_line(ValueError("")) == "ValueError"
    assert len(first_line(ValueError("x" * 1000))) == 200


def test_a_missing_extra_says_how_to_install_it_on_both_sides_of_a_process_border() -> None:
    error = MissingExtraError("demo", "zoedepth demo")
    for found in (error, pickle.loads(pickle.dumps(error))):
        assert (found.extra, found.feature) == ("demo", "zoedepth demo")
        assert str(found) == "zoedepth demo needs the extra [demo]. Install it: pip install 'zoedepth[demo]'"


def test_every_optional_library_is_known_with_the_extra_that_installs_it() -> None:
    extras: dict[str, set[str]] = {}
    for line in requires("zoedepth") or []:
        library, extra = re.fullmatch(r"([\w-]+).*?(?:extra == '(\w+)')?", line).groups()
        extras.setdefault(extra, set()).add(library.lower())
    extras = {name: found for name, found in extras.items() if name not in (None, "dev", "docs", "mutants")}
    modules = {"skimage": "scikit-image"}
    known = {name: modules.get(name, name).lower().replace("_", "-") for name in OPTIONAL}
    for name, extra in OPTIONAL.items():
        assert known[name] in extras[extra]
    assert set().union(*extras.values()) == set(known.values())


@pytest.mark.parametrize(
    ("name", "known", "expected"),
    [
        ("zoed-lit", ["zoed-lite", "zoed-m12-n"], ["zoed-lite"]),
        ("zoed-lite", ["zoed_lite_relative", "zoed_lite"], ["zoed_lite"]),
        ("Eval", ["evaluate", "demo"], ["evaluate"]),
        ("10n", ["10m", "80m"], ["10m"]),
        ("optim.lr", ["optim.learning-rate", "model.lr"], ["optim.learning-rate"]),
        ("optm.wd", ["optim.weight-decay", "optim.eps"], ["optim.weight-decay"]),
        ("qqq", ["evaluate", "demo"], []),
        ("", ["evaluate"], []),
    ],
)
def test_similar(name: str, known: list[str], expected: list[str]) -> None:
    assert similar(name, known) == expected


def test_names_that_do_not_exist_are_told_with_those_that_do() -> None:
    assert str(no_such("head", "bin", ["bins", "dorn"])) == (
        "there is no head 'bin': did you mean bins? There are bins, dorn"
    )
    assert str(no_such("head", "x", ["bins", "dorn"])) == "there is no head 'x'; there are bins, dorn"
    many = [f"name{number}" for number in range(20)]
    assert str(no_such("recipe", "x", many, see="zoedepth train --help")) == (
        "there is no recipe 'x'; see zoedepth train --help"
    )
