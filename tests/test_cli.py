"""The command line: help, exit codes, and errors in one line instead of a traceback."""

import errno
import io
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

import zoedepth
from zoedepth import cli
from zoedepth.cli import COMMANDS, Command, main
from zoedepth.commands.data import SUBCOMMANDS
from zoedepth.commands.jobs import SUBCOMMANDS as JOBS
from zoedepth.errors import InputError, MissingExtraError, TrainingError


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_lists_every_command(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([flag]) == 0
    output = capsys.readouterr().out
    for name, command in COMMANDS.items():
        assert f"  {name} " in output
        assert command.help in output


def test_without_a_command_the_help_is_shown_and_it_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    output = capsys.readouterr()
    assert all(name in output.out + output.err for name in COMMANDS)


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert zoedepth.__version__ in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["predct", "photo.jpg"], "predict"),
        (["eval"], "evaluate"),
        (["demo_train"], "demo-train"),
        (["data", "lst"], "list"),
        (["data", "check", "nyuu", "folder"], "nyu"),
        (["data", "check", "--shet", "a.jpg", "x"], "--sheet"),
        (["train", "zoed-lite", "--data", "x", "--out", "o"], "zoed_lite"),
        (["train", "fintune"], "finetune"),
        (["train", "finetune", "--data", "x", "--out", "o", "--lr", "1"], "--learning-rate"),
        (["train", "demo", "--data", "x", "--out", "o", "--config.optim.lr", "1"], "--config.optim.learning-rate"),
        (["train", "demo", "--config.optm.learning-rte=1"], "--config.optim.learning-rate"),
        (["predict", "photo.jpg", "--ot", "folder"], "--out"),
        (["predict", "photo.jpg", "--png_scal", "256"], "--png-scale"),
    ],
)
def test_a_slip_gets_the_right_word_in_one_line(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    output = capsys.readouterr()
    assert f"did you mean {meant}?" in output.err
    assert len(output.err.splitlines()) == 1
    assert output.out == ""


def test_a_command_that_looks_like_none_gets_them_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["qqq"]) == 2
    said = capsys.readouterr().err
    assert all(name in said for name in COMMANDS)


HELPS = [
    *([name] for name in COMMANDS),
    *(["data", name] for name in SUBCOMMANDS),
    *(["jobs", name] for name in JOBS),
    ["train", "finetune"],
]


@pytest.mark.parametrize("columns", [60, 200])
@pytest.mark.parametrize("words", HELPS, ids=" ".join)
def test_help_fits_the_terminal_and_has_no_line_beyond_100_columns(
    words: list[str], columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    with suppress(SystemExit):
        assert main([*words, "--help"]) == 0
    output = capsys.readouterr().out
    assert f"zoedepth {' '.join(words)}" in output
    widest = max(map(len, output.splitlines()))
    assert widest <= (100 if columns == 200 or words in (["data"], ["jobs"], ["train"]) else columns)
    assert "STR" not in output.partition("options")[0], "words that only programmers know, in the usage line"


def test_unknown_flag_is_an_error_that_names_it(capsys: pytest.CaptureFixture[str]) -> None:
    for name in set(COMMANDS) - {"train", "data", "jobs"}:
        assert main([name, "--no-such-flag", "1"]) == 2
        assert "--no-such-flag" in capsys.readouterr().err


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Adds the command "fail", which raises."""

    def add(error: BaseException) -> None:
        def fail(arguments: Sequence[str]) -> int:
            raise error

        monkeypatch.setitem(cli.COMMANDS, "fail", Command("fails", lambda: fail, reads_itself=True))

    return add


@pytest.mark.parametrize(
    "error",
    [
        InputError("the photo is blank"),
        TrainingError("the photo is blank"),
        MissingExtraError("demo", "the photo is blank: seeing more"),
    ],
)
def test_errors_made_on_purpose_are_one_line(
    failing: Callable[[BaseException], None], error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(error)
    assert main(["fail"]) == 2
    output = capsys.readouterr()
    assert output.err.startswith("zoedepth fail: ")
    assert "the photo is blank" in output.err
    assert len(output.err.splitlines()) == 1
    assert output.out == ""


def test_interruption_has_its_own_exit_code(
    failing: Callable[[BaseException], None], capsys: pytest.CaptureFixture[str]
) -> None:
    failing(KeyboardInterrupt())
    assert main(["fail"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_what_the_system_refuses_is_one_line(
    failing: Callable[[BaseException], None], capsys: pytest.CaptureFixture[str]
) -> None:
    for error, said in (
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device: make room"),
        (PermissionError(errno.EACCES, "Permission denied", "/root/a.json"), "/root/a.json: Permission denied"),
        (OSError(errno.EROFS, "Read-only file system", b"/mnt/\xe4"), "Read-only file system: write to another"),
        (IsADirectoryError(errno.EISDIR, "Is a directory", "photos"), "photos: Is a directory"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "a" * 300), "give a shorter name"),
        (OSError("of a library\nin two lines"), "of a library in two lines"),
        (ValueError("Error while serializing: I/O error: No space left on device (os error 28)"), "make room"),
        (RuntimeError("[enforce fail at inline_container.cc:672] . unexpected pos 576 vs 534"), "make room"),
        (MemoryError(), "memory"),
        (RuntimeError("CUDA out of memory. Tried to allocate 2 GiB"), "memory"),
        (ModuleNotFoundError("No module named 'tensorboard'", name="tensorboard.compat"), "zoedepth[train]"),
    ):
        failing(error)
        assert main(["fail"]) == 2
        output = capsys.readouterr()
        assert output.err.startswith("zoedepth fail: ")
        assert said in output.err
        assert len(output.err.splitlines()) == 1
        assert output.out == ""


def test_closed_pipe_ends_without_a_word(
    failing: Callable[[BaseException], None], capsys: pytest.CaptureFixture[str]
) -> None:
    failing(BrokenPipeError(errno.EPIPE, "Broken pipe"))
    assert main(["fail"]) == 141
    stop = SystemExit(1)
    stop.__context__ = BrokenPipeError()  # what rich makes of it
    failing(stop)
    assert main(["fail"]) == 141
    assert capsys.readouterr().err == ""


def test_what_is_left_in_a_buffer_is_noticed_before_python_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Full(io.StringIO):
        def flush(self) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys, "stdout", Full())
    assert main(["--version"]) == 2
    assert "No space left on device" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "utf-8"])
@pytest.mark.parametrize("errors", ["strict", "surrogateescape"])
def test_letters_that_a_code_page_does_not_have_become_escapes(
    encoding: str, errors: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding, errors=errors))

    def show(words: Sequence[str]) -> int:
        print("客厅 † caf\udce9")
        Console().print(Table("客", "k\udce9"))
        return 0

    monkeypatch.setitem(cli.COMMANDS, "show", Command("", lambda: show, reads_itself=True))
    assert main(["show"]) == 0
    text = written.getvalue()
    assert (b"\\u5ba2" if encoding != "utf-8" else "客".encode()) in text
    assert (b"caf\xe9" if (encoding, errors) == ("utf-8", "surrogateescape") else b"caf\\udce9") in text


def test_another_encoding_than_utf8_starts_python_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(os, "execv", lambda _, words: started.append(words))
    monkeypatch.setattr(sys, "argv", ["zoedepth", "--version"])
    monkeypatch.setattr(sys, "orig_argv", ["python", "/bin/zoedepth", "--version"])
    assert main() == 0
    assert started == []
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: "ascii")
    assert main() == 0
    assert started == [[sys.executable, "-X", "utf8", "/bin/zoedepth", "--version"]]


def test_user_without_a_home_has_a_place_for_downloads(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.delenv("TORCH_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert main(["models"]) == 0
    assert capsys.readouterr().out.rstrip().splitlines()[-1].strip().startswith(tempfile.gettempdir())
    assert os.environ["XDG_CACHE_HOME"].startswith(tempfile.gettempdir()), "other libraries use it, too"


def test_threads_wait_asleep_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    assert main(["models"]) == 0
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
    monkeypatch.delenv("OMP_WAIT_POLICY")
    assert main(["models"]) == 0
    assert os.environ["OMP_WAIT_POLICY"] == "PASSIVE"


def test_warnings_are_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def warn(words: Sequence[str]) -> int:
        sys.stderr.write(warnings.formatwarning("the photo\nis dark", UserWarning, "file.py", 3))
        return 0

    before = warnings.formatwarning
    monkeypatch.setitem(cli.COMMANDS, "warn", Command("", lambda: warn, reads_itself=True))
    assert main(["warn"]) == 0
    assert capsys.readouterr().err == "zoedepth warn: warning: the photo is dark\n"
    assert warnings.formatwarning is before


def test_bugs_are_not_hidden(failing: Callable[[BaseException], None]) -> None:
    for bug in (ZeroDivisionError, RuntimeError, ModuleNotFoundError):
        failing(bug("a bug"))
        with pytest.raises(bug):
            main(["fail"])


def test_what_a_command_returns_is_the_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Sequence[str]] = []
    monkeypatch.setitem(
        cli.COMMANDS, "one", Command("", lambda: lambda rest: seen.append(rest) or 1, reads_itself=True)
    )
    assert main(["one", "a", "--b"]) == 1
    assert seen == [["a", "--b"]]


def test_module_is_the_command(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "zoedepth", "predict", "nowhere.jpg", "--out", "out"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert process.returncode == 2
    assert process.stdout == ""
    assert "nowhere.jpg" in process.stderr
    assert "Traceback" not in process.stderr


def test_sigterm_cleans_up_and_has_its_own_exit_code(tmp_path: Path) -> None:
    code = f"""
import signal, sys, tempfile
from zoedepth import cli

def work(arguments):
    with tempfile.TemporaryDirectory(dir={str(tmp_path)!r}):
        signal.raise_signal(signal.SIGTERM)

cli.COMMANDS["work"] = cli.Command("works", lambda: work, reads_itself=True)
code = cli.main(["work"])
assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
sys.exit(code)
"""
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert process.returncode == 143, process.stderr
    assert process.stderr == "zoedepth work: terminated\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("closed", ["stdin", "stdout", "stderr"])
def test_a_closed_stream_is_no_traceback(monkeypatch: pytest.MonkeyPatch, closed: str) -> None:
    monkeypatch.setattr(sys, closed, None)  # what Python has after >&-
    assert main(["models"]) == 0
    assert main(["nothing"]) == 2
