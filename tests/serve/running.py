"""A service that runs in this process, on a free port, and what a client of it needs."""

import io
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPResponse
from typing import Any, NamedTuple

import numpy as np
import uvicorn
from PIL import Image
from tests.servers import PATIENCE

from zoedepth.serve.app import Service, create_app
from zoedepth.serve.server import bind, make_config
from zoedepth.serve.settings import Settings

PREFIX = "urn:zoedepth:problem:"


class Answer(NamedTuple):
    """An answer, read to its end."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)

    @property
    def problem(self) -> str:
        """The kind of problem that it tells of; empty where it tells of none."""
        if self.headers.get("content-type") != "application/problem+json":
            return ""
        assert self.json["status"] == self.status
        return self.json["type"].removeprefix(PREFIX)


class Client:
    """A client of a service on this machine."""

    def __init__(self, port: int, service: Service, server: uvicorn.Server) -> None:
        self.port = port
        self.service = service
        self._server = server

    @property
    def n_connections(self) -> int:
        """Connections that the service has open, to all clients."""
        return len(self._server.server_state.connections)

    @property
    def n_stalled(self) -> int:
        """Connections whose clients do not take their answers."""
        return sum(each.flow.write_paused for each in tuple(self._server.server_state.connections))

    def ask(
        self, path: str, body: bytes | None = None, *, method: str = "", headers: Mapping[str, str] | None = None
    ) -> Answer:
        """Send a request; a body alone is a photo of a kind that nobody says."""
        kind = {} if body is None else {"Content-Type": "application/octet-stream"}
        connection = HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            connection.request(method or ("GET" if body is None else "POST"), path, body, {**kind, **(headers or {})})
            return read(connection.getresponse())
        finally:
            connection.close()

    def form(self, path: str, parts: Mapping[str, bytes], *, headers: Mapping[str, str] | None = None) -> Answer:
        """Send a form."""
        body, kind = form_of(parts)
        return self.ask(path, body, headers={"Content-Type": kind, **(headers or {})})

    def connect(self) -> socket.socket:
        """Open a connection, to send bytes one by one."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)


@contextmanager
def running(settings: Settings) -> Iterator[Client]:
    """Run a service until the block ends."""
    service = create_app(settings)
    listener = bind("127.0.0.1", 0)
    server = uvicorn.Server(make_config(service, settings))
    thread = threading.Thread(target=server.run, args=([listener],))
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.005)
    try:
        yield Client(listener.getsockname()[1], service, server)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


def read(response: HTTPResponse) -> Answer:
    """Read an answer to its end."""
    return Answer(response.status, {name.lower(): value for name, value in response.getheaders()}, response.read())


def form_of(parts: Mapping[str, bytes], *, boundary: str = "9f3b") -> tuple[bytes, str]:
    """Return a form and its Content-Type."""
    pieces = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"; filename="../../etc/{name}"\r\n\r\n'.encode()
        + content
        + b"\r\n"
        for name, content in parts.items()
    ]
    return b"".join([*pieces, f"--{boundary}--\r\n".encode()]), f"multipart/form-data; boundary={boundary}"


def photo(width: int = 64, height: int = 48, *, seed: int = 0, format: str = "PNG", **options: Any) -> bytes:
    """Return the file of a photo of coloured noise, smooth enough to be small."""
    values = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(values).resize((width, height), Image.Resampling.BICUBIC).save(file, format, **options)
    return file.getvalue()


def read_maps(content: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read the answer of ?format=maps as its documentation says, with nothing of ours."""
    assert content[:8] == b"ZOEDMAPS"
    (length,) = struct.unpack_from("<I", content, 8)
    header = json.loads(content[12 : 12 + length])
    types = {"float32": "<f4", "uint8": "u1"}
    arrays = {}
    for name, about in header["arrays"].items():
        count = about["shape"][0] * about["shape"][1]
        assert about["offset"] % 8 == 0
        values = np.frombuffer(content, types[about["type"]], count, about["offset"])
        arrays[name] = values.reshape(about["shape"])
    return header, arrays
