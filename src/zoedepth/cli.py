"""The command line: ``COMMANDS`` lists every command. The options of one are the arguments of its function."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from zoedepth.errors import ZoeDepthError


@dataclass(frozen=True)
class Command:
    """A command: its line in the help, and how to import its function, which happens when the command is called."""

    help: str
    load: Callable[[], Callable[[Sequence[str]], int]]


def _demo() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.demo import demo

    return _with_options(demo)


def _predict() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.predict import predict

    return _with_options(predict)


def _evaluate() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.evaluate import evaluate

    return _with_options(evaluate)


def _train() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.train import train

    return train


def _data() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.data import data

    return data


def _demo_train() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.demo_train import demo_train

    return _with_options(demo_train)


def _models() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.models import models

    return _with_options(models)


def _convert() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.convert import convert

    return _with_options(convert)


def _export() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.export import export

    return _with_options(export)


def _push() -> Callable[[Sequence[str]], int]:
    from zoedepth.commands.convert import push

    return _with_options(push)


COMMANDS = {
    "demo": Command("show the depth of three photographs, with the error where the depth was measured", _demo),
    "demo-train": Command("train a tiny model in both stages on rendered scenes", _demo_train),
    "predict": Command("write the depth in metres of photos, folders or globs", _predict),
    "train": Command("train a recipe, go on with a run, or fine-tune on your own photos", _train),
    "evaluate": Command("score models on photos with known depth, as the paper does", _evaluate),
    "data": Command("list the published data sets, check a download, write shards", _data),
    "models": Command("list the models that have a name, and which are on this machine", _models),
    "convert": Command("write a model in another layout: ours, the original's, transformers'", _convert),
    "export": Command("write a model for other programs: ONNX, OpenVINO, torch.export", _export),
    "push": Command("publish a model on the Hugging Face Hub", _push),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 some files failed, 2 wrong input, 130 interrupted."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_help())
        return 0 if arguments else 2
    if arguments[0] == "--version":
        from zoedepth import __version__

        print(f"zoedepth {__version__}")
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        print(f"zoedepth: there is no command {name!r}\n\n{_help()}", file=sys.stderr)
        return 2
    try:
        return COMMANDS[name].load()(rest)
    except ZoeDepthError as error:
        print(f"zoedepth {name}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print(": ".join(filter(None, (f"zoedepth {name}: interrupted", str(interrupt)))), file=sys.stderr)
        return 130


def _with_options(function: Callable[..., int]) -> Callable[[Sequence[str]], int]:
    """Return a function that reads the options of ``function`` from the command line and calls it."""

    def run(arguments: Sequence[str]) -> int:
        import tyro

        prog = f"zoedepth {function.__name__.replace('_', '-')}"
        return tyro.cli(function, args=list(arguments), prog=prog)

    return run


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
