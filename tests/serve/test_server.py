import errno
import logging
import os
import socket
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.servers import PATIENCE
from uvicorn.supervisors import Multiprocess

from zoedepth.errors import InputError
from zoedepth.serve.app import create_app
from zoedepth.serve.metrics import FOLDER_VARIABLE
from zoedepth.serve.protocol import PatientProtocol
from zoedepth.serve.server import _Processes, bind, make_config
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


def test_the_gauges_of_a_process_that_died_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def process(pid: int, *, alive: bool) -> SimpleNamespace:
        return SimpleNamespace(pid=pid, process=SimpleNamespace(is_alive=lambda: alive))

    def replace_dead(processes: Multiprocess) -> None:
        monkeypatch.setattr(processes, "processes", [process(3, alive=True), process(2, alive=True)])

    files = [tmp_path / f"{kind}_{pid}.db" for kind in ("gauge_livesum", "counter") for pid in (1, 2)]
    for file in files:
        file.touch()
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setattr(Multiprocess, "__init__", lambda *_: None)  # it would take all signals of this process
    monkeypatch.setattr(Multiprocess, "keep_subprocess_alive", replace_dead)
    processes = _Processes(make_config(None, Settings()), [])
    monkeypatch.setattr(processes, "processes", [process(1, alive=True), process(2, alive=True)], raising=False)
    processes.keep_subprocess_alive()
    assert sorted(tmp_path.iterdir()) == sorted(files)
    monkeypatch.setattr(processes, "processes", [process(1, alive=False), process(2, alive=True)])
    processes.keep_subprocess_alive()
    assert sorted(tmp_path.iterdir()) == sorted(files[1:])
