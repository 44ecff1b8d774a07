import asyncio
import errno
import json
import logging
import os
import signal
import socket
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.servers import PATIENCE
from uvicorn.config import STARTUP_FAILURE
from uvicorn.supervisors import Multiprocess

from zoedepth.errors import InputError
from zoedepth.serve.app import create_app
from zoedepth.serve.metrics import FOLDER_VARIABLE
from zoedepth.serve.protocol import PatientProtocol
from zoedepth.serve.server import _Processes, application, bind, make_config, run, run_several
from zoedepth.serve.settings import Limits, Settings


def test_a_socket_listens_at_the_address_alone() -> None:
    with bind("127.0.0.1", 0) as listener:
        assert listener.getsockname()[0] == "127.0.0.1"
        with socket.create_connection(listener.getsockname(), timeout=PATIENCE):
            pass
        with pytest.raises(InputError, match="--port"):
            bind("127.0.0.1", listener.getsockname()[1])


def test_a_name_of_no_address_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match=r"999\.0\.0\.1:0 is no address .*not known.* --host"):
        bind("999.0.0.1", 0)


def test_an_address_of_another_machine_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def elsewhere(*_: object) -> None:
        raise OSError(errno.EADDRNOTAVAIL, os.strerror(errno.EADDRNOTAVAIL))

    monkeypatch.setattr(socket.socket, "bind", elsewhere)
    with pytest.raises(InputError, match=r"cannot listen at 192\.0\.2\.1:0 .* --host"):
        bind("192.0.2.1", 0)


@pytest.mark.parametrize("port", [-1, 65_536, 70_000])
def test_a_port_that_is_none_is_refused(port: int) -> None:
    with pytest.raises(InputError, match="--port"):
        bind("127.0.0.1", port)


def test_the_server_trusts_no_header_and_says_nothing_about_itself() -> None:
    config = make_config(create_app(), Settings(limits=Limits(grace=7)))
    config.load()
    assert config.http_protocol_class is PatientProtocol
    assert not config.proxy_headers
    assert not config.server_header
    assert config.timeout_graceful_shutdown == 7
    assert not config.access_log
    assert make_config(None, Settings(), access_log=True).access_log


def test_handlers_of_other_libraries_stay_open(capsys: pytest.CaptureFixture[str]) -> None:
    """Those of absl close the stream that they write to with themselves: with it went the output of a program."""
    closed = []
    theirs = logging.StreamHandler()
    theirs.close = lambda: closed.append(theirs)
    make_config(None, Settings(), access_log=True)
    assert closed == []
    logging.getLogger("uvicorn.error").error("it is broken")
    logging.getLogger("uvicorn.access").info('%s - "%s %s HTTP/%s" %d', "1.2.3.4:5", "GET", "/readyz", "1.1", 200)
    said = capsys.readouterr()
    assert "it is broken" in said.err
    assert '1.2.3.4:5 - "GET /readyz HTTP/1.1" 200' in said.out
    make_config(None, Settings())
    logging.getLogger("uvicorn.access").info('%s - "%s %s HTTP/%s" %d', "1.2.3.4:5", "GET", "/readyz", "1.1", 200)
    assert capsys.readouterr().out == ""


def test_gauges_and_drafts_of_a_process_that_died_are_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def process(pid: int, *, alive: bool) -> SimpleNamespace:
        return SimpleNamespace(pid=pid, process=SimpleNamespace(is_alive=lambda: alive))

    def replace_dead(processes: Multiprocess) -> None:
        monkeypatch.setattr(processes, "processes", [process(3, alive=True), process(2, alive=True)])

    drafts = tmp_path / "drafts"
    for pid in (1, 2):
        (drafts / f"zoedepth-{pid}-x").mkdir(parents=True)
    monkeypatch.setattr("zoedepth.serve.answers.memory_folder", lambda: str(drafts))
    numbers = tmp_path / "numbers"
    numbers.mkdir()
    files = [numbers / f"{kind}_{pid}.db" for kind in ("gauge_livesum", "counter") for pid in (1, 2)]
    for file in files:
        file.touch()
    monkeypatch.setenv(FOLDER_VARIABLE, str(numbers))
    monkeypatch.setattr(Multiprocess, "__init__", lambda *_: None)  # it would take all signals of this process
    monkeypatch.setattr(Multiprocess, "keep_subprocess_alive", replace_dead)
    processes = _Processes(make_config(None, Settings()), [])
    monkeypatch.setattr(processes, "processes", [process(1, alive=True), process(2, alive=True)], raising=False)
    processes.keep_subprocess_alive()
    assert sorted(numbers.iterdir()) == sorted(files)
    monkeypatch.setattr(processes, "processes", [process(1, alive=False), process(2, alive=True)])
    processes.keep_subprocess_alive()
    assert sorted(numbers.iterdir()) == sorted(files[1:])
    assert [path.name for path in drafts.iterdir()] == ["zoedepth-2-x"]


def test_drafts_of_processes_that_a_signal_ended_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that is ended while a thread writes cannot remove what that has begun."""

    class Ended:
        ended_by = signal.SIGTERM
        processes = (SimpleNamespace(pid=1, exitcode=-15), SimpleNamespace(pid=2, exitcode=0))

        def __init__(self, *_: object) -> None:
            pass

        def run(self) -> None:
            for pid in (1, 2, 3):
                (tmp_path / f"zoedepth-{pid}-x").mkdir()
                (tmp_path / f"zoedepth-{pid}-x" / "photo.png").write_text("half a photo")

    raised: list[int] = []
    monkeypatch.setattr("zoedepth.serve.answers.memory_folder", lambda: str(tmp_path))
    monkeypatch.setattr("zoedepth.serve.server._Processes", Ended)
    monkeypatch.setattr("zoedepth.serve.server.find", lambda source: None)
    monkeypatch.setattr(signal, "raise_signal", raised.append)
    with bind("127.0.0.1", 0) as listener:
        run_several(Settings(), listener, workers=2)
    assert raised == [signal.SIGTERM]
    assert [path.name for path in tmp_path.glob("zoedepth-[123]-*")] == ["zoedepth-3-x"], "it is nobody's of these"


def test_a_process_of_several_leaves_no_drafts_after_its_lifespan(
    model_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoedepth.serve.answers.memory_folder", lambda: str(tmp_path))
    monkeypatch.setattr("zoedepth.serve.server.set_thread_count", lambda number: None)
    told = {"workers": 2, "settings": asdict(Settings((model_file,), threads=1))}
    monkeypatch.setenv("ZOEDEPTH_SERVE", json.dumps(told))
    draft = tmp_path / f"zoedepth-{os.getpid()}-x"
    sent: list[str] = []

    async def live() -> None:
        events = iter(["lifespan.startup", "lifespan.shutdown"])

        async def receive() -> dict[str, str]:
            draft.mkdir(exist_ok=True)
            return {"type": next(events)}

        async def send(message: Mapping[str, str]) -> None:
            sent.append(message["type"])

        await application()({"type": "lifespan", "asgi": {"version": "3.0"}, "state": {}}, receive, send)

    asyncio.run(live())
    assert sent == ["lifespan.startup.complete", "lifespan.shutdown.complete"]
    assert not draft.exists()


def test_a_model_that_cannot_be_loaded_is_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As processes of several say it; one alone loads its models before."""
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no weights")
    settings = Settings((str(broken),))
    with bind("127.0.0.1", 0) as listener, pytest.raises(SystemExit) as end:
        run(create_app(settings), settings, listener)
    assert end.value.code == STARTUP_FAILURE
    said = capsys.readouterr().err
    assert "broken.safetensors" in said
    assert "Traceback" not in said
