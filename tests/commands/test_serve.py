import errno
import io
import json
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from http.client import HTTPConnection
from inspect import signature
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from tests.servers import PATIENCE

from zoedepth.cli import main
from zoedepth.commands.serve import TOKEN, serve
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.serve.server import bind
from zoedepth.serve.settings import Limits, Settings
from zoedepth.weights.save import save_model


@pytest.fixture
def model_file(tiny_model: ZoeDepth, tmp_path: Path) -> str:
    save_model(tiny_model, tmp_path / "tiny.safetensors")
    return str(tmp_path / "tiny.safetensors")


def photo() -> bytes:
    file = io.BytesIO()
    values = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


class NoAnswer(Exception):
    """The connection ended before an answer began."""


def ask(port: int, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    try:
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        try:
            connection.request("POST" if body else "GET", path, body, {"Content-Type": "image/png", **given})
            answer = connection.getresponse()
        except (ConnectionError, TimeoutError) as error:  # the service ends, or has ended
            raise NoAnswer(error) from error
        return answer.status, answer.read()
    finally:
        connection.close()


def is_ready(port: int) -> bool:
    try:
        return ask(port, "/readyz")[0] == 200
    except (NoAnswer, OSError):  # it does not listen yet
        return False


def serve_and(play: Callable[[int], None], *options: str, end: signal.Signals = signal.SIGTERM) -> int:
    """Run the command in this thread while ``play`` has another one; returns its exit code after the signal."""
    failures: list[BaseException] = []
    ended = threading.Event()
    ports: SimpleQueue[int | None] = SimpleQueue()

    def told(host: str, port: int) -> socket.socket:
        listener = bind(host, port)
        ports.put(listener.getsockname()[1])
        return listener

    def client() -> None:
        try:
            port = ports.get(timeout=PATIENCE)
            assert port is not None, "the service has not begun"
            deadline = time.monotonic() + PATIENCE
            while not is_ready(port):
                assert time.monotonic() < deadline
                assert not ended.wait(0.02), "the service has ended by itself"
            play(port)
        except BaseException as failure:
            failures.append(failure)
        finally:
            if not ended.is_set():  # or the signal would end the tests
                os.kill(os.getpid(), end)

    thread = threading.Thread(target=client)
    thread.start()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("zoedepth.serve.server.bind", told)
            code = main(["serve", "--port", "0", *options])
    finally:
        ended.set()
        ports.put(None)
        thread.join()
    if failures:
        raise failures[0]
    return code


@pytest.mark.parametrize(("end", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_it_says_where_it_is_and_ends_by_signal(
    end: signal.Signals, code: int, model_file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    answers = []
    # A shell's script starts with SIGINT ignored what it does not wait for.
    interrupted = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert (
            serve_and(lambda port: answers.append(ask(port, "/v1/depth", photo())), "--model", model_file, end=end)
            == code
        )
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, interrupted)
    assert answers[0][0] == 200
    assert re.search(r"serves .*tiny.* at http://127\.0\.0\.1:\d+/ ", capsys.readouterr().out)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_token_comes_from_the_environment_or_a_file(
    model_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "token").write_text("0123456789abcdef\n")
    statuses = []

    def play(port: int) -> None:
        statuses.append(ask(port, "/v1/models")[0])
        statuses.append(ask(port, "/v1/models", Authorization="Bearer 0123456789abcdef")[0])

    serve_and(play, "--model", model_file, "--token-file", str(tmp_path / "token"))
    assert statuses == [401, 200]
    monkeypatch.setenv(TOKEN, "short")
    assert main(["serve", "--port", "0", "--model", model_file]) == 2
    assert "16" in capsys.readouterr().err
    assert main(["serve", "--port", "0", "--token-file", str(tmp_path / "none")]) == 2


def test_sigterm_under_load_breaks_no_answer(model_file: str) -> None:
    results: list[object] = []
    stop = threading.Event()

    def load(port: int) -> None:
        while not stop.is_set():
            try:
                status, body = ask(port, "/v1/depth?format=maps", photo())
                results.append(status)
                if status == 200:
                    length = int.from_bytes(body[8:12], "little")
                    arrays = json.loads(body[12 : 12 + length])["arrays"]
                    assert len(body) >= arrays["valid"]["offset"] + 48 * 64
                else:
                    assert json.loads(body)["type"].endswith(("shutting-down", "busy"))
            except NoAnswer as error:
                results.append(type(error))
            except Exception as error:  # an error of a thread would only be a warning
                results.append(error)

    threads: list[threading.Thread] = []

    def play(port: int) -> None:
        threads.extend(threading.Thread(target=load, args=(port,)) for _ in range(6))
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + PATIENCE
        while results.count(200) < 5:
            assert time.monotonic() < deadline
            time.sleep(0.01)

    try:
        assert serve_and(play, "--model", model_file, "--threads", "1") == 143
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert results.count(200) >= 5
    assert not [result for result in results if isinstance(result, Exception)]
    assert {result for result in results if isinstance(result, int)} <= {200, 429, 503}


def test_a_thread_that_still_computes_does_not_hold_up_the_end(
    model_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()
    batch = Predictor.batch
    ended: list[int] = []
    answers: list[tuple[int, bytes]] = []

    def held(self: Predictor, images: list, **options: object) -> list[DepthMap]:
        begun.set()
        assert go_on.wait(PATIENCE)
        return batch(self, images, **options)

    monkeypatch.setattr(Predictor, "batch", held)
    monkeypatch.setattr("os._exit", ended.append)
    asking: list[threading.Thread] = []

    def play(port: int) -> None:
        asking.append(threading.Thread(target=lambda: answers.append(ask(port, "/v1/depth", photo()))))
        asking[0].start()
        assert begun.wait(PATIENCE)

    try:
        assert serve_and(play, "--model", model_file, "--threads", "1", "--grace", "2") == 143
        assert ended == [143]
    finally:
        go_on.set()
        for thread in asking:
            thread.join()
    assert [status for status, _ in answers] == [503]


def test_several_processes_serve_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the model in the package, which needs no torch: to import it takes each process seconds."""
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    seen: list[bytes] = []

    def play(port: int) -> None:
        for _ in range(4):
            assert ask(port, "/v1/depth", photo())[0] == 200
        seen.append(ask(port, "/metrics")[1])

    assert serve_and(play, "--model", "zoed-lite", "--workers", "2", "--threads", "1") == 143
    assert b'zoedepth_requests_total{path="/v1/depth",status="200"} 4.0' in seen[0]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--workers", "0"), "--workers"),
        (("--queue", "-1"), "queue"),
        (("--max-body", "0"), "max_body"),
        (("--allow-host", "http://a"), "--allow-host"),
        (("--model", "no-such-model"), "no-such-model"),
    ],
)
def test_what_cannot_be_served_is_told_in_a_line(
    options: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--port", "0", *options]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert error.count("\n") == 1


def test_an_address_of_another_machine_is_told_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def elsewhere(*_: object) -> None:
        raise OSError(errno.EADDRNOTAVAIL, os.strerror(errno.EADDRNOTAVAIL))

    monkeypatch.setattr(socket.socket, "bind", elsewhere)
    assert main(["serve", "--port", "0", "--host", "192.0.2.1"]) == 2
    error = capsys.readouterr().err
    assert "--host" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("workers", [1, 2])
def test_all_options_arrive(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "token").write_text("0123456789abcdef")
    typed = {
        "--host": ["192.0.2.1"], "--port": ["3"], "--model": ["one", "two"], "--open": [],
        "--workers": [str(workers)], "--threads": ["4"], "--batch-size": ["5"], "--device": ["mps"],
        "--precision": ["bfloat16"], "--token-file": [str(tmp_path / "token")], "--allow-host": ["a.org", "b.org"],
        "--allow-origin": ["https://c.org", "https://d.org"], "--max-body": ["6"], "--max-pixels": ["7"],
        "--queue": ["8"], "--max-wait": ["9.5"], "--max-seconds": ["10.5"], "--grace": ["11.5"], "--access-log": [],
    }  # fmt: skip
    settings = Settings(
        models=("one", "two"),
        device="mps",
        precision="bfloat16",
        threads=4,
        batch_size=5,
        token="0123456789abcdef",
        hosts=("a.org", "b.org"),
        origins=("https://c.org", "https://d.org"),
        limits=Limits(max_body=6, max_pixels=7, queue=8, max_wait=9.5, max_seconds=10.5, grace=11.5),
    )
    names = {option.removeprefix("--").replace("-", "_") for option in typed}
    assert names == {name.rstrip("_") for name in signature(serve).parameters}

    arrived: list[object] = []
    listener, service = SimpleNamespace(getsockname=lambda: ("192.0.2.1", 3)), SimpleNamespace(load=lambda: None)

    def listen(host: str, port: int) -> nullcontext[SimpleNamespace]:
        arrived.append((host, port))
        return nullcontext(listener)

    def create(settings: Settings) -> SimpleNamespace:
        arrived.append(settings)
        return service

    def take(*given: object, **named: object) -> None:
        arrived.append((given, named))
        raise InputError("this is all that the test wants to know")

    monkeypatch.setattr("zoedepth.serve.server.bind", listen)
    monkeypatch.setattr("zoedepth.serve.app.create_app", create)
    monkeypatch.setattr("zoedepth.serve.server.run", take)
    monkeypatch.setattr("zoedepth.serve.server.run_several", take)
    monkeypatch.setattr("webbrowser.open", arrived.append)
    assert main(["serve", *(word for option, values in typed.items() for word in (option, *values))]) == 2
    assert "this is all" in capsys.readouterr().err
    page = "http://192.0.2.1:3/"
    if workers == 1:
        rest = [settings, page, ((service, settings, listener), {"access_log": True})]
    else:
        rest = [page, ((settings, listener), {"workers": workers, "access_log": True})]
    assert arrived == [("192.0.2.1", 3), *rest]


def test_installed_stands_for_the_models_on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    from zoedepth.commands.serve import _chosen

    monkeypatch.setattr("zoedepth.weights.load.cached", lambda hub_id: False)
    assert _chosen(("installed", "zoed-lite"))[0] == "zoed-lite"
    assert len(_chosen(("installed", "zoed-lite"))) == len(set(_chosen(("installed",))))
