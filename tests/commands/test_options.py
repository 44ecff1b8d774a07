"""The words of a command line become the arguments of a function, and the help shows what its docstring says."""

import os
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

from zoedepth.commands.options import WIDTH, call, words_of
from zoedepth.errors import InputError

given: dict[str, object] = {}


def command(
    photos: Annotated[tuple[str, ...], tyro.conf.Positional],
    *,
    out: Path = Path("depth"),
    size: int | None = None,
    pad: Literal["model", "yes", "no"] = "model",
    save: tuple[str, ...] = (),
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Do something with photos.

    Args:
        photos: photos, folders or globs.
        out: folder for the results, which is made if it does not exist, and which may hold the results of an earlier
            run of this command.
        size: size of the network's input.
        pad: whether to add a border.
        save: kinds of files.
        json_: print JSON.
    """
    given.update(photos=photos, out=out, size=size, pad=pad, save=save, json=json_)
    return 7


def shown(capsys: pytest.CaptureFixture[str], *, common: tuple[str, ...] = ()) -> str:
    with pytest.raises(SystemExit) as stop:
        call(command, ["--help"], prog="zoedepth do", common=common)
    assert not stop.value.code
    return capsys.readouterr().out


@pytest.mark.parametrize("common", [(), ("out", "json_")])
def test_words_become_arguments_wherever_the_help_shows_them(common: tuple[str, ...]) -> None:
    words = ["a.jpg", "b.jpg", "--out", "here", "--size", "96", "--pad", "no", "--save", "depth", "npz", "--json"]
    assert call(command, words, prog="zoedepth do", common=common) == 7
    assert given == {
        "photos": ("a.jpg", "b.jpg"), "out": Path("here"), "size": 96, "pad": "no", "save": ("depth", "npz"),
        "json": True,
    }  # fmt: skip
    assert call(command, ["a.jpg"], prog="zoedepth do", common=common) == 7
    assert given == {
        "photos": ("a.jpg",), "out": Path("depth"), "size": None, "pad": "model", "save": (), "json": False,
    }  # fmt: skip


def test_common_options_come_first_and_the_others_under_a_heading(capsys: pytest.CaptureFixture[str]) -> None:
    text = shown(capsys, common=("out", "json_"))
    first, heading, rest = text.partition("more options")
    assert heading
    assert all(option in first for option in ("PHOTOS...", "--out", "--json"))
    assert all(option in rest and option not in first for option in ("--size", "--pad", "--save"))
    assert "more options" not in shown(capsys)


def test_help_says_what_the_docstring_says(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    text = shown(capsys)
    assert max(map(len, text.splitlines())) <= WIDTH
    words = " ".join(text.replace("│", " ").split())
    assert "Do something with photos." in words
    assert "which may hold the results of an earlier run of this command." in words
    assert "usage: zoedepth do [-h] [OPTIONS] PHOTOS..." in words
    assert "--pad {model,yes,no}" in words
    assert "(default: depth)" in words
    assert "None" not in words, "a default that says nothing"
    assert "--no-json" not in words
    assert os.environ["COLUMNS"] == "300"


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("--ot", r"there is no option --ot: did you mean --out\? See zoedepth do --help"),
        ("--size_=3", r"there is no option --size_: did you mean --size\?"),
        ("--elephant", r"there is no option --elephant\. See"),
    ],
)
def test_an_option_that_does_not_exist_is_an_error_with_the_right_one(word: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call(command, ["a.jpg", word], prog="zoedepth do")


def test_a_value_that_is_none_is_said_by_tyro(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        call(command, ["a.jpg", "--size", "large"], prog="zoedepth do")
    assert stop.value.code == 2
    printed = capsys.readouterr()
    assert "large" in printed.err
    assert printed.out == ""


def test_words_say_the_options_that_are_given() -> None:
    options = {"--fast": True, "--no-flip": False, "--model": None, "--compat": (), "--intrinsics": (1.5, 2.0)}
    assert words_of(options) == ["--fast", "--intrinsics", "1.5", "2.0"]
