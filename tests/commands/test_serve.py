import io
import json
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.cli import main
from zoedepth.commands.serve import TOKEN
from zoedepth.model.zoedepth import ZoeDepth
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


def ask(port: int, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=20)
    try:
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request("POST" if body else "GET", path, body, {"Content-Type": "image/png", **given})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


@contextmanager
def free_port() -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        yield probe.getsockname()[1]


def serve_and(play: Callable[[int], None], *options: str, end: signal.Signals = signal.SIGTERM) -> int:
    """Run the command in this thread while ``play`` has another one; returns its exit code after the signal."""
    failures: list[BaseException] = []
    ended = threading.Event()
    with free_port() as port:
        pass

    def client() -> None:
        try:
            deadline = time.monotonic() + 300
            while True:
                try:
                    if ask(port, "/readyz")[0] == 200:
                        break
                except OSError:
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
        code = main(["serve", "--port", str(port), *options])
    finally:
        ended.set()
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
            except (ConnectionError, TimeoutError) as error:  # before an answer began
                results.append(type(error))
            except HTTPException as error:
                results.append(error if type(error).__name__ == "IncompleteRead" else type(error))

    threads: list[threading.Thread] = []

    def play(port: int) -> None:
        threads.extend(threading.Thread(target=load, args=(port,)) for _ in range(6))
        for thread in threads:
            thread.start()
        while results.count(200) < 5:
            time.sleep(0.01)

    assert serve_and(play, "--model", model_file, "--threads", "1") == 143
    stop.set()
    for thread in threads:
        thread.join()
    assert results.count(200) >= 5
    assert not [result for result in results if isinstance(result, Exception)]
    assert {result for result in results if isinstance(result, int)} <= {200, 429, 503}


def test_several_processes_serve_together(model_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    seen: list[bytes] = []

    def play(port: int) -> None:
        for _ in range(4):
            assert ask(port, "/v1/depth", photo())[0] == 200
        seen.append(ask(port, "/metrics")[1])

    assert serve_and(play, "--model", model_file, "--workers", "2", "--threads", "1") == 143
    assert b'zoedepth_requests_total{path="/v1/depth",status="200"} 4.0' in seen[0]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--workers", "0"), "--workers"),
        (("--queue", "-1"), "queue"),
        (("--max-body", "0"), "max_body"),
        (("--allow-host", "http://a"), "--allow-host"),
        (("--model", "no-such-model"), "no-such-model"),
        (("--host", "192.0.2.1"), "--host"),
    ],
)
def test_what_cannot_be_served_is_told_in_a_line(
    options: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--port", "0", *options]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert error.count("\n") == 1


def test_installed_stands_for_the_models_on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    from zoedepth.commands.serve import _chosen

    monkeypatch.setattr("zoedepth.weights.hub.cached", lambda hub_id: False)
    assert _chosen(("installed", "zoed-lite"))[0] == "zoed-lite"
    assert len(_chosen(("installed", "zoed-lite"))) == len(set(_chosen(("installed",))))
