"""``zoedepth serve``: the page in the browser, and the service for programs."""

import os
import signal
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from zoedepth.errors import InputError, Terminated

EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143

TOKEN = "ZOEDEPTH_TOKEN"
"""Variable of the environment with the token, which no list of processes shows."""


def serve(
    *,
    host: str = "127.0.0.1",
    port: int = 8000,
    model: tuple[str, ...] = ("zoed-lite",),
    open_: Annotated[bool, tyro.conf.arg(name="open")] = False,
    workers: int = 1,
    threads: int | None = None,
    batch_size: int | None = None,
    device: str = "auto",
    precision: Literal["float32", "bfloat16", "float16"] = "float32",
    token_file: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    allow_host: tuple[str, ...] = (),
    allow_origin: tuple[str, ...] = (),
    max_body: int = 50_000_000,
    max_pixels: int = 50_000_000,
    queue: int = 64,
    max_wait: float = 30.0,
    max_seconds: float = 60.0,
    grace: float = 15.0,
    access_log: bool = False,
) -> int:
    """Serve the page and the API, from this machine and without a network, until Ctrl-C or SIGTERM.

    Open the address that is printed, or send photos: curl --data-binary @photo.jpg -H 'Content-Type: image/jpeg'
    http://127.0.0.1:8000/v1/depth -o depth.png. Nothing that is sent is kept. Exit codes: 2 it cannot start, 130 ended
    by Ctrl-C, 143 by SIGTERM.

    Args:
        host: address to listen at. 127.0.0.1 is reached from this machine alone; 0.0.0.0 and :: from others, too.
        port: port to listen at; 0 takes a free one.
        model: models that can be chosen, the first is the default: names of `zoedepth models`, files or folders of
            weights, Hugging Face ids, or files of `zoedepth export` (.onnx, .xml). "installed" stands for all models of
            `zoedepth models` that are on this machine.
        open_: open the page in the browser.
        workers: processes, each with models and a queue of its own.
        threads: photos that are computed at the same time in a process; without it, one on each core.
        batch_size: photos of one size that go through a model together; without it 8 on an accelerator, 1 on the CPU.
        device: cpu, cuda, mps, or auto for the best there is; zoed-lite runs on the CPU where no driver of an
            accelerator is found.
        precision: bfloat16 is faster on hardware made for it; float16 is for GPUs.
        token_file: file with a token that every request must bring (Authorization: Bearer TOKEN). The variable
            ZOEDEPTH_TOKEN of the environment says one, too.
        allow_host: names by which the service may be called, beside localhost and addresses in numbers.
        allow_origin: sites whose pages may call the service, e.g. https://example.org.
        max_body: bytes of the body of a request, at most.
        max_pixels: pixels of a photo, at most.
        queue: requests that wait, at most; one more gets 429.
        max_wait: seconds that a request waits, at most, before it gets 503.
        max_seconds: seconds that a request takes, at most, before it gets 503.
        grace: seconds that requests have to end after SIGTERM or Ctrl-C.
        access_log: log every request.
    """
    from zoedepth.serve.answers import remove_drafts
    from zoedepth.serve.app import create_app
    from zoedepth.serve.server import bind, run, run_several
    from zoedepth.serve.settings import Limits, Settings
    from zoedepth.threads import cpu_count, share_cores

    if workers < 1:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    limits = Limits(
        max_body=max_body, max_pixels=max_pixels, queue=queue, max_wait=max_wait, max_seconds=max_seconds, grace=grace
    )
    settings = Settings(
        _chosen(model), device, precision, threads, batch_size,
        token=_token(token_file), hosts=allow_host, origins=allow_origin, limits=limits,
    )  # fmt: skip
    # A script that starts it with & leaves it no handler of SIGINT, and the exit code is promised there, too.
    ends = {signal.SIGTERM: _end, signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in ends.items()}
    try:
        with bind(host, port) as listener:
            address = _address(host, listener.getsockname()[1])
            if workers > 1:
                _tell(address, settings.models, open_=open_)
                run_several(settings, listener, workers=workers, access_log=access_log)
                return 0
            with share_cores(threads or cpu_count()):
                service = create_app(settings)
                service.load()
                _tell(address, settings.models, open_=open_)
                code = 0
                try:
                    run(service, settings, listener, access_log=access_log)
                except KeyboardInterrupt as interrupt:
                    code = EXIT_TERMINATED if isinstance(interrupt, Terminated) else EXIT_INTERRUPTED
                if service.is_computing:  # for clients who have their answer, that it took too long
                    remove_drafts()
                    os._exit(code)
                return code
    except Terminated:
        return EXIT_TERMINATED
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(*_: object) -> None:
    raise Terminated


def _tell(address: str, models: tuple[str, ...], *, open_: bool) -> None:
    """Print where the service is, and open its page if that is asked for."""
    Console(highlight=False).print(f"ZoeDepth serves {', '.join(models)} at {address} (Ctrl-C ends it)", soft_wrap=True)
    sys.stdout.flush()
    if open_:
        webbrowser.open(address)


def _chosen(models: tuple[str, ...]) -> tuple[str, ...]:
    """Return the models, with those on this machine in place of "installed"."""
    from zoedepth.weights.load import is_here
    from zoedepth.weights.releases import RELEASES

    here: list[str] = []
    if "installed" in models:
        here = [name for name, each in RELEASES.items() if is_here(each)]
    named = [each for model in models for each in (here if model == "installed" else [model])]
    return tuple(dict.fromkeys(named))


def _token(file: Path | None) -> str | None:
    """Return the token that the options say; None where they say none."""
    if file is None:
        return os.environ.get(TOKEN) or None
    try:
        return file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--token-file {file} cannot be read: {error}") from error


def _address(host: str, port: int) -> str:
    """Return the address for a browser on this machine."""
    name = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{name}:{port}/"
