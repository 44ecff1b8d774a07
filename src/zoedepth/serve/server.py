"""The process or processes that serve: uvicorn, a socket, and the end of it all."""

import json
import logging
import os
import signal
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

import uvicorn
from prometheus_client.multiprocess import mark_process_dead
from uvicorn.config import STARTUP_FAILURE
from uvicorn.logging import AccessFormatter, DefaultFormatter
from uvicorn.supervisors import Multiprocess

from zoedepth.config import from_dict
from zoedepth.errors import InputError
from zoedepth.serve.answers import memory_folder, remove_drafts
from zoedepth.serve.app import Service, create_app
from zoedepth.serve.guard import Application, Receive, Scope, Send
from zoedepth.serve.metrics import FOLDER_VARIABLE
from zoedepth.serve.settings import Settings
from zoedepth.threads import cpu_count, set_thread_count
from zoedepth.weights.exported import is_exported
from zoedepth.weights.load import find

_BACKLOG = 2048
_MAX_HEAD = 32_768  # bytes of the head of a request
_KEEP_ALIVE = 5  # seconds
_APPLICATION = "zoedepth.serve.server:application"
_TOLD = "ZOEDEPTH_SERVE"  # variable of the environment


def bind(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address.

    Raises:
        InputError: the address is not one of this machine, or taken, or needs rights.
    """
    if not 0 <= port < 1 << 16:
        raise InputError(f"a port is a number from 0 to 65535, got {port}: choose another one (--port)")
    try:
        (family, _, _, _, address), *_ = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        listener = socket.socket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise InputError(f"{host}:{port} is no address of this machine ({error}): choose --host and --port") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        raise InputError(f"cannot listen at {host}:{port} ({error}): choose another --port, or --host") from error
    listener.set_inheritable(True)
    return listener


def run(service: Service, settings: Settings, listener: socket.socket, *, access_log: bool = False) -> None:
    """Serve in this process until a signal ends it: SIGTERM and Ctrl-C finish what is computed, and refuse what waits.

    The signal is raised again at the end. Load the models before, and inside of ``share_cores``.

    Args:
        service: the application.
        settings: the settings that it was made of.
        listener: a socket that listens, see ``bind``.
        access_log: True logs every request.
    """
    uvicorn.Server(make_config(service, settings, access_log=access_log)).run([listener])


def run_several(settings: Settings, listener: socket.socket, *, workers: int, access_log: bool = False) -> None:
    """Serve in several processes, each with models and a queue of its own, until a signal ends it, as ``run`` does.

    Args:
        settings: the settings of the service. Cores are shared among the processes.
        listener: a socket that listens, see ``bind``.
        workers: the number of processes. One that dies is replaced.
        access_log: True logs every request.

    Raises:
        InputError: there is no such model.
    """
    for source in settings.models:
        if not is_exported(source):
            find(source)  # downloaded once, and not by all of them
    settings = replace(settings, threads=settings.threads or max(1, cpu_count() // workers))
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with _told_to_processes(settings, workers):
        config = make_config(_APPLICATION, settings, workers=workers, access_log=access_log)
        processes = _Processes(config, [listener])
        processes.run()
    for process in processes.processes:  # a signal may have ended it while a thread wrote
        remove_drafts(process.pid)
    if any(process.exitcode == STARTUP_FAILURE for process in processes.processes):
        raise InputError("a process could not start: what it says is above")
    for number, handler in before.items():
        signal.signal(number, handler)
    signal.raise_signal(processes.ended_by)


class _Processes(Multiprocess):
    """Processes that know which signal has ended them."""

    ended_by = signal.SIGTERM
    _counted: frozenset[int | None] = frozenset()

    def keep_subprocess_alive(self) -> None:
        """Replace processes that have died. One that is slow, on a busy machine, is waited for."""
        if not all(process.process.is_alive() for process in self.processes):
            super().keep_subprocess_alive()
        now = frozenset(process.pid for process in self.processes)
        for pid in self._counted - now:  # what it computed and who waited for it went with it
            mark_process_dead(pid)
            remove_drafts(pid)
        self._counted = now

    def handle_int(self) -> None:
        """Remember the signal, and end."""
        self.ended_by = signal.SIGINT
        super().handle_int()


class _Config(uvicorn.Config):
    """A config that adds handlers for logs, where uvicorn's own closes those of all other libraries in the process."""

    def configure_logging(self) -> None:
        """Write errors to standard error and requests, if they are asked for, to standard output."""
        super().configure_logging()
        logging.getLogger("python_multipart").setLevel(logging.ERROR)  # what hostile clients send shall not fill it
        said = logging.StreamHandler(sys.stderr)
        said.setFormatter(DefaultFormatter("%(levelprefix)s %(message)s"))
        logging.getLogger("uvicorn").handlers = [said]
        logging.getLogger("uvicorn").propagate = False
        if self.access_log:
            requests = logging.StreamHandler(sys.stdout)
            requests.setFormatter(
                AccessFormatter('%(levelprefix)s %(client_addr)s - "%(request_line)s" %(status_code)s')
            )
            logging.getLogger("uvicorn.access").handlers = [requests]
            logging.getLogger("uvicorn.access").propagate = False


def make_config(app: Any, settings: Settings, *, workers: int = 1, access_log: bool = False) -> uvicorn.Config:
    """Return how uvicorn is to serve.

    Args:
        app: the application; with several processes, the name of a function that makes it.
        settings: the settings of the service.
        workers: the number of processes.
        access_log: True logs every request.
    """
    return _Config(
        app,
        factory=workers > 1,
        loop="asyncio",
        http="zoedepth.serve.protocol:PatientProtocol",
        ws="none",
        lifespan="on",
        workers=workers,
        backlog=_BACKLOG,
        proxy_headers=False,
        server_header=False,
        access_log=access_log,
        log_config=None,
        log_level="info" if access_log else "error",
        timeout_keep_alive=_KEEP_ALIVE,
        timeout_graceful_shutdown=round(settings.limits.grace),
        timeout_worker_healthcheck=30,
        h11_max_incomplete_event_size=_MAX_HEAD,
    )


def application() -> Application:
    """Make the application in one process of several, as ``run_several`` tells it by the environment.

    A signal ends the process right after the lifespan, whatever its threads still write: drafts are removed before.
    """
    told = json.loads(os.environ[_TOLD])
    settings = from_dict(Settings, told["settings"], where=_TOLD)
    set_thread_count(max(1, cpu_count() // (told["workers"] * (settings.threads or 1))))
    service = create_app(settings)

    async def process(scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await service(scope, receive, send)
        finally:
            if scope["type"] == "lifespan":
                remove_drafts()

    return process


@contextmanager
def _told_to_processes(settings: Settings, workers: int) -> Iterator[None]:
    """Tell processes that are started in the block what to serve, and where they add up their numbers.

    What is handed to a process in another way is imported there before it can say that it is alive.
    """
    with tempfile.TemporaryDirectory(prefix="zoedepth-", dir=memory_folder()) as folder:
        told = {_TOLD: json.dumps({"workers": workers, "settings": asdict(settings)}), FOLDER_VARIABLE: folder}
        os.environ |= told
        try:
            yield
        finally:
            for name in told:
                del os.environ[name]
