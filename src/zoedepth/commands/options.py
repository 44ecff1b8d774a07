"""Options of a command: the arguments of its function, read from the command line and explained by ``--help``."""

import inspect
import io
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import MISSING, field, make_dataclass
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import tyro

from zoedepth.errors import InputError, similar

WIDTH = 100
"""Longest line of a help, in columns."""

_Options = TypeVar("_Options")
_FLAG = re.compile(r"^[│|]? *(?:-\w [^,\n]*, )?(--[\w.-]+)[^,\n]*(?:, (--[\w.-]+))?", re.MULTILINE)


def call(function: Callable[..., int], arguments: Sequence[str], *, prog: str, common: Sequence[str] = ()) -> int:
    """Read the arguments of a function from the command line, and call it.

    Args:
        function: function whose docstring describes every argument. Annotations may hold ``tyro.conf``'s words.
        arguments: the words of the command line behind the command.
        prog: how the command is called, "zoedepth predict".
        common: options that the help shows first; the others follow under "more options". Empty: there is one list.

    Raises:
        InputError: see ``read``.
    """
    about, helps = _docstring(function)
    hints = get_type_hints(function, include_extras=True)
    first: list[tuple[str, Any, Any]] = []
    rest: list[tuple[str, Any, Any]] = []
    for name, parameter in inspect.signature(function).parameters.items():
        default = MISSING if parameter.default is parameter.empty else parameter.default
        positional = parameter.kind is not parameter.KEYWORD_ONLY
        hidden = default is None or default == () or positional  # "(default: None)" says nothing
        entry = (
            name,
            _explained(hints[name], name, helps[name], flag=default is False, hidden=hidden),
            field(default=default),
        )
        (first if positional or not common or name in common else rest).append(entry)
    if rest:  # tyro writes a heading for nested options: the name of the field
        more = make_dataclass("More", rest, kw_only=True)
        first.append(("more", tyro.conf.OmitArgPrefixes[more], field()))
    values = vars(read(make_dataclass("Options", first, kw_only=True), arguments, prog=prog, description=about))
    nested = values.pop("more", None)
    return function(**values, **({} if nested is None else vars(nested)))


def words_of(options: Mapping[str, object]) -> list[str]:
    """Return the words of a command line that say these options; None, False and () are those that are not given."""
    words: list[str] = []
    for name, value in options.items():
        if value is None or value is False or value == ():
            continue
        values = value if isinstance(value, tuple) else () if value is True else (value,)
        words += [name, *(str(each) for each in values)]
    return words


def read(
    kind: type[_Options],
    arguments: Sequence[str],
    *,
    prog: str,
    description: str | None = None,
    default: _Options | None = None,
    config: Sequence[Any] = (),
) -> _Options:
    """Read a dataclass of options from the command line.

    Args:
        kind: the dataclass.
        arguments: the words of the command line behind the command.
        prog: how the command is called.
        description: text above the options; None: the docstring of ``kind``.
        default: values of options that are not given.
        config: words of ``tyro.conf`` that hold for all options.

    Raises:
        InputError: an option does not exist. The message names those that look like it.
        SystemExit: the help was asked for, or tyro has said what is wrong with a value.
    """
    chosen: dict[str, Any] = {} if default is None else {"default": default}

    def parse(words: Sequence[str]) -> _Options:
        return tyro.cli(kind, args=list(words), prog=prog, description=description, config=tuple(config), **chosen)

    said, shown = _Record(), _Record()
    with _narrow() as width:
        try:
            with redirect_stdout(said), redirect_stderr(said):
                return parse(arguments)
        except SystemExit as stop:
            if not stop.code:
                print(_wrapped(said.getvalue(), width), end="")
                raise
            with redirect_stdout(shown), suppress(SystemExit):
                parse(["--help"])
            _require_known(arguments, {flag for match in _FLAG.findall(shown.getvalue()) for flag in match}, prog)
            sys.stderr.write(said.getvalue())
            raise


def _require_known(arguments: Sequence[str], flags: set[str], prog: str) -> None:
    """Raise an InputError for the first option that does not exist."""
    for argument in arguments:
        if argument == "--":
            return
        flag = argument.partition("=")[0].replace("_", "-")
        if argument.startswith("--") and flag not in flags:
            alike = similar(flag, sorted(filter(None, flags)))
            question = f": did you mean {' or '.join(alike)}?" if alike else "."
            raise InputError(f"there is no option {argument.partition('=')[0]}{question} See {prog} --help")


def _explained(hint: Any, name: str, text: str, *, flag: bool, hidden: bool) -> Any:
    """Return a type with what the help says of it. The type's own words of ``tyro.conf`` have the last say.

    Args:
        hint: the type.
        name: name of the argument.
        text: the argument's description.
        flag: it is False if it is not given.
        hidden: the help does not show the default.
    """
    base, *words = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    metavar = _metavar(base, name)
    if tyro.conf.UseAppendAction in words and metavar:
        metavar = metavar.removesuffix("...")  # one each time
    about = tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint="" if hidden else None)
    if flag:
        words.append(tyro.conf.FlagCreatePairsOff)  # --json, without --no-json
    # Made while it runs, of as many words as there are: no type checker can know it.
    return Annotated[(base, about, *words)]  # pyright: ignore[reportInvalidTypeForm]


def _metavar(kind: Any, name: str) -> str | None:
    """Return what stands for a value in the help; None leaves it to tyro."""
    kinds = [each for each in get_args(kind) if each is not NoneType]
    if NoneType in get_args(kind):
        return _metavar(kinds[0], name) or (kinds[0].__name__.upper() if kinds[0] in (int, float) else None)
    if get_origin(kind) is Literal:
        return f"{{{','.join(map(str, kinds))}}}"
    if get_origin(kind) is tuple and kinds[-1] is Ellipsis:
        return f"{_metavar(kinds[0], name)}..."
    if kind is Path:
        return "PATH"
    return name.strip("_").upper().replace("_", "-") if kind is str else None


def _docstring(function: Callable[..., int]) -> tuple[str, dict[str, str]]:
    """Return the text above ``Args:``, and that of each argument in one line."""
    about, _, arguments = inspect.cleandoc(function.__doc__ or "").partition("\n\nArgs:\n")
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", arguments, re.MULTILINE)
    return about, {name: re.sub(r"\s+", " ", text) for name, text in entries}


def _wrapped(text: str, width: int) -> str:
    """Break the long lines of a help: tyro puts options into boxes that fit, and a paragraph above them on one line."""
    lines = re.sub(r"\n{3,}", "\n\n", text).split("\n")
    in_box = tuple("╭│╰+|\x1b")
    return "\n".join(line if line.startswith(in_box) else textwrap.fill(line, width) for line in lines)


class _Record(io.StringIO):
    """Text that is written as for standard output: with boxes and colours where they can be shown."""

    # A StringIO has it as an attribute that is None.
    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return sys.__stdout__.encoding if sys.__stdout__ else "utf-8"

    def isatty(self) -> bool:
        return bool(sys.__stdout__ and sys.__stdout__.isatty())


@contextmanager
def _narrow() -> Iterator[int]:
    """Tell tyro, which asks the environment first, that the terminal has ``WIDTH`` columns at most; give the width."""
    before = os.environ.get("COLUMNS")
    width = min(shutil.get_terminal_size().columns, WIDTH)
    os.environ["COLUMNS"] = str(width)
    try:
        yield width
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
