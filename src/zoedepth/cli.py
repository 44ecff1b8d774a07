"""The command line: ``COMMANDS`` lists every command. The options of one are the arguments of its function.

Here every error becomes one line and an exit code, and what cannot be written in the terminal's letters is written in
others. Bugs are shown as they are.
"""

import errno
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path

from zoedepth.errors import OPTIONAL, MissingExtraError, Terminated, ZoeDepthError, is_no_memory, no_such

WRONG, INTERRUPTED, NOBODY_READS, TERMINATED = 2, 130, 141, 143
"""Exit codes. All but the first are 128 and the number of the signal, as shells count: Ctrl-C, ``| head``, SIGTERM."""

_OTHER_PLACE = ("make room, or write to another place",)
_WHAT_TO_DO = {
    errno.ENOSPC: _OTHER_PLACE,
    errno.EDQUOT: _OTHER_PLACE,
    errno.EFBIG: _OTHER_PLACE,
    errno.EROFS: ("write to another place",),
    errno.EACCES: ("ask for the right to it, or choose another place",),
    errno.EPERM: ("ask for the right to it, or choose another place",),
    errno.ENOENT: ("check the path",),
    errno.ENOTDIR: ("a part of the path is a file: check the path",),
    errno.EISDIR: ("give a file, not a folder",),
    errno.EEXIST: ("give another name",),
    errno.ENAMETOOLONG: ("give a shorter name",),
    errno.EMFILE: ("allow more open files (ulimit -n), or give fewer --workers",),
    errno.EIO: ("the disk or the network drive fails: copy the data to another one",),
}
_OF_RUST = re.compile(r"\(os error (\d+)\)")  # safetensors
_OF_TORCH = "inline_container.cc"  # torch.save

Function = Callable[..., int]


@dataclass(frozen=True)
class Command:
    """A command: its line in the help, and how to import its function, which happens when the command is called."""

    help: str
    load: Callable[[], Function]
    common: tuple[str, ...] = ()
    """Options that the help shows first; empty: there are few."""
    reads_itself: bool = False
    """The function reads the words of the command line, because it has commands of its own."""


def _demo() -> Function:
    from zoedepth.commands.demo import demo

    return demo


def _predict() -> Function:
    from zoedepth.commands.predict import predict

    return predict


def _jobs() -> Function:
    from zoedepth.commands.jobs import jobs

    return jobs


def _calibrate() -> Function:
    from zoedepth.commands.calibrate import calibrate

    return calibrate


def _view() -> Function:
    from zoedepth.commands.view import view

    return view


def _evaluate() -> Function:
    from zoedepth.commands.evaluate import evaluate

    return evaluate


def _train() -> Function:
    from zoedepth.commands.train import train

    return train


def _reproduce() -> Function:
    from zoedepth.commands.reproduce import reproduce

    return reproduce


def _verify() -> Function:
    from zoedepth.commands.verify import verify

    return verify


def _data() -> Function:
    from zoedepth.commands.data import data

    return data


def _demo_train() -> Function:
    from zoedepth.commands.demo_train import demo_train

    return demo_train


def _models() -> Function:
    from zoedepth.commands.models import models

    return models


def _doctor() -> Function:
    from zoedepth.commands.doctor import doctor

    return doctor


def _convert() -> Function:
    from zoedepth.commands.convert import convert

    return convert


def _export() -> Function:
    from zoedepth.commands.export import export

    return export


def _benchmark() -> Function:
    from zoedepth.commands.benchmark import benchmark

    return benchmark


def _push() -> Function:
    from zoedepth.commands.convert import push

    return push


def _serve() -> Function:
    from zoedepth.commands.serve import serve

    return serve


COMMANDS = {
    "demo": Command("show the depth of three photographs, with the error where the depth was measured", _demo),
    "demo-train": Command("train a tiny model in both stages on rendered scenes", _demo_train),
    "predict": Command(
        "write the depth in metres of photos, folders or globs", _predict, ("out", "model", "save", "domain", "device")
    ),
    "jobs": Command("say what the shards of a large job have done, and merge them", _jobs, reads_itself=True),
    "calibrate": Command(
        "put the metres of a camera's photos right by a few readings of a tape measure",
        _calibrate,
        ("photo", "at", "between", "depth", "depth_scale", "along_ray", "form", "out", "add", "undo"),
    ),
    "view": Command(
        "show a photo, a mesh or a cloud in three dimensions, in the browser",
        _view,
        ("out", "cloud", "panorama", "up", "model", "domain"),
    ),
    "serve": Command(
        "serve a page for the browser and an API for programs",
        _serve,
        ("host", "port", "model", "open_", "workers", "device", "token_file"),
    ),
    "train": Command("train a recipe, go on with a run, or fine-tune on your own photos", _train, reads_itself=True),
    "evaluate": Command(
        "score models on photos with known depth, as the paper does",
        _evaluate,
        ("data", "model", "predictions", "out", "with_paper", "json_", "device"),
    ),
    "reproduce": Command(
        "train and score every row of a table of the paper",
        _reproduce,
        ("table", "data", "out", "small", "seeds", "shard", "show"),
    ),
    "verify": Command("compare the released weights with the paper's numbers, on the official data", _verify),
    "data": Command("list the published data sets, check a download, write shards", _data, reads_itself=True),
    "models": Command("list the models that have a name, and which are on this machine", _models),
    "doctor": Command("look at this installation: versions, extras, folders, one prediction", _doctor),
    "convert": Command("write a model in another layout: ours, the original's, transformers'", _convert),
    "export": Command("write a model for other programs: ONNX, OpenVINO, torch.export", _export),
    "benchmark": Command(
        "measure a model in every runtime that is installed here, for predict --fast",
        _benchmark,
        ("model", "photos", "json_", "int8", "device"),
    ),
    "push": Command("publish a model on the Hugging Face Hub", _push),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 some files failed, 2 wrong input, 130 interrupted.

    141: whoever read our output has stopped reading, as ``| head`` does. 143: SIGTERM came.
    """
    if arguments is None:
        _speak_utf8()
        arguments = sys.argv[1:]
    arguments = list(arguments)
    name = " ".join(["zoedepth", *(word for word in arguments[:1] if word in COMMANDS)])
    for stream, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, stream) is None:  # it was closed (>&-): Python has none then
            setattr(sys, stream, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - for the process
    for stream in (sys.stdout, sys.stderr):
        _accept_all_letters(stream)
    try:
        with _warnings_in_one_line(name), _terminated_as_interrupted():
            code = _run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()  # a full disk or a closed pipe is noticed here, and not while Python ends
        return code
    except ZoeDepthError as error:
        return _stop(WRONG, f"{name}: {error}")
    except Terminated as terminated:
        return _stop(TERMINATED, ": ".join(filter(None, (f"{name}: terminated", str(terminated)))))
    except KeyboardInterrupt as interrupt:
        return _stop(INTERRUPTED, ": ".join(filter(None, (f"{name}: interrupted", str(interrupt)))))
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in OPTIONAL:
            raise
        return _stop(
            WRONG, f"{name}: {MissingExtraError(OPTIONAL[module], f'{module} is not installed: what you ask for')}"
        )
    except BrokenPipeError:
        return _stop(NOBODY_READS)
    except SystemExit as stop:  # tyro has shown the help, or said what is wrong; or rich has met a closed pipe
        if isinstance(stop.__context__, BrokenPipeError):
            return _stop(NOBODY_READS)
        _stop(0)
        raise
    except Exception as error:  # of all that goes wrong, what people can mend is one line; the rest is raised again
        if (refusal := _refusal(error)) is not None:
            return _stop(WRONG, f"{name}: {_describe(refusal)}")
        if is_no_memory(error):
            return _stop(
                WRONG, f"{name}: there is too little memory: give smaller photos, fewer workers, smaller batches"
            )
        raise


def _run(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_help(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else WRONG
    if arguments[0] == "--version":
        from zoedepth import __version__

        print(f"zoedepth {__version__}")
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        raise no_such("command", name, COMMANDS)
    _give_a_cache()
    # Threads shall wait for each other asleep: awake, they keep the processor from those that have work to do, such as
    # the processes that read the samples of a training. torch reads it when it is imported.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    command = COMMANDS[name]
    function = command.load()
    if command.reads_itself:
        return function(rest)
    from zoedepth.commands.options import call

    return call(function, rest, prog=f"zoedepth {name}", common=command.common)


def _give_a_cache() -> None:
    """Tell all libraries where files are kept for a user without a home: they would make a folder called "~" here."""
    if not os.environ.get("XDG_CACHE_HOME") and not os.path.isdir(os.path.expanduser("~/.cache")):
        from zoedepth.download import cache_home

        os.environ["XDG_CACHE_HOME"] = str(cache_home())


def _speak_utf8() -> None:
    """Start anew in Python's UTF-8 mode where the locale has another encoding: names and texts would be garbled."""
    if os.name == "posix" and sys.getfilesystemencoding() != "utf-8":
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def _accept_all_letters(stream: object) -> None:
    """Let a stream write letters that its code page does not have: as escapes, e.g. \\u5ba2 in Windows' cp1252."""
    if isinstance(stream, TextIOWrapper) and (stream.errors == "strict" or stream.encoding.lower() != "utf-8"):
        stream.reconfigure(errors="backslashreplace")


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM, with which systems and schedulers end a program, clean up as Ctrl-C does: drafts are removed.

    Commands with an end of their own (``predict``, ``serve``, ``train``) take the signal themselves meanwhile.
    """
    own = os.getpid()

    def end(number: int, _: object) -> None:
        if os.getpid() != own:  # a process that was forked from this one has nothing to clean up
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        raise Terminated

    in_main = threading.current_thread() is threading.main_thread()  # others get no signals
    if not in_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _warnings_in_one_line(name: str) -> Iterator[None]:
    """Print warnings without the line of code that they come from."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"{name}: warning: {_one_line(str(message))}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


def _refusal(error: Exception) -> OSError | None:
    """Return what the system has refused, where an error tells of that; other libraries hide it in errors of theirs."""
    if isinstance(error, OSError):
        return error
    if found := _OF_RUST.search(str(error)):
        return OSError(int(found[1]), os.strerror(int(found[1])))
    if _OF_TORCH in str(error):
        hidden = OSError("a file cannot be written whole: make room, or write to another place")
        return error.__context__ if isinstance(error.__context__, OSError) else hidden
    return None


def _describe(error: OSError) -> str:
    """Return what happened to which file, and what to do."""
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
    what = [" and ".join(names)] if names else []
    return ": ".join(
        [*what, error.strerror or str(error) or type(error).__name__, *_WHAT_TO_DO.get(error.errno or 0, ())]
    )


def _one_line(text: str) -> str:
    return re.sub(r"\s*\n\s*", " ", text.strip())


def _stop(code: int, message: str = "") -> int:
    """Print why the command ends, and return its exit code."""
    if message and sys.stderr is not None:
        with suppress(OSError):
            print(_one_line(message), file=sys.stderr)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:  # nobody reads, or the disk is full: what is left goes nowhere, or Python complains at its end
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return code


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.help}" for name, command in COMMANDS.items()]
    return "\n".join([
        "usage: zoedepth COMMAND [OPTIONS]     (zoedepth COMMAND --help for the options)",
        "",
        "Depth in metres from a single photo.",
        "",
        *lines,
    ])  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
