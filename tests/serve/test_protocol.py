import json
import re
import socket
import time
from contextlib import suppress

import pytest
from tests.serve.running import Client, photo, running
from tests.servers import PATIENCE

from zoedepth.serve.settings import Limits, Settings


@pytest.mark.parametrize("start", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: "])
def test_a_connection_without_a_head_is_cut_off(start: bytes, model_file: str) -> None:
    with running(Settings((model_file,), limits=Limits(idle=0.1))) as client, client.connect() as connection:
        connection.sendall(start)
        with suppress(ConnectionResetError):
            assert connection.recv(100) == b""


@pytest.mark.parametrize(
    "noise",
    [b"\x16\x03\x01\x02\0\1\0\1\xfc\3\3" + bytes(50) + b"\r\n\r\n", b"hello\r\n\r\n",
     b"GET / HTTP/1.1\r\nHost: a\r\nContent-Length: x\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n",
     b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\n"],
)  # fmt: skip
def test_what_is_no_http_gets_a_problem(noise: bytes, client: Client) -> None:
    with client.connect() as connection:
        connection.sendall(noise)
        answer = b""
        while piece := connection.recv(65536):
            answer += piece
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 400")
    assert b"application/problem+json" in head
    assert json.loads(body)["type"].endswith("malformed-request")


def test_a_client_that_does_not_take_its_answer_is_cut_off(model_file: str) -> None:
    with running(Settings((model_file,), limits=Limits(idle=0.5))) as client:
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(("127.0.0.1", client.port))
        page = b"GET /three.min.js HTTP/1.1\r\nHost: localhost\r\n\r\n"
        connection.sendall(page * 40)  # more than the buffers of the system hold
        deadline = time.monotonic() + PATIENCE
        while client.n_connections == 0:  # until it is there
            assert time.monotonic() < deadline
            time.sleep(0.01)
        while client.n_connections:  # and until it is cut off
            assert time.monotonic() < deadline
            time.sleep(0.01)
        received = 0
        with connection, suppress(ConnectionError):
            while piece := connection.recv(1 << 20):
                received += len(piece)
        whole = len(client.ask("/three.min.js").body)
        assert received < 40 * whole
        assert client.ask("/healthz").status == 200


def test_a_byte_more_is_no_sign_that_the_answer_is_taken(model_file: str) -> None:
    body = photo(1300, 1000, format="JPEG")
    head = f"POST /v1/depth?format=maps HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n\r\n"
    with running(Settings((model_file,), limits=Limits(idle=0.5))) as client, socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(("127.0.0.1", client.port))
        connection.sendall(head.encode() + body)
        deadline = time.monotonic() + PATIENCE
        # 12 MB are more than the buffers of the system hold. On a busy machine it may be cut off before that is seen.
        came = False
        while not client.n_stalled and not (came and not client.n_connections):
            came = came or client.n_connections > 0
            assert time.monotonic() < deadline
            time.sleep(0.01)
        with suppress(ConnectionError):
            connection.sendall(b"G")
        while client.n_connections:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_requests_in_a_row_on_one_connection_are_answered_in_order(client: Client) -> None:
    with client.connect() as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n" * 2 + b"GET /x HTTP/1.1\r\nHost: localhost\r\n"
                           b"Connection: close\r\n\r\n")  # fmt: skip
        answer = b""
        while piece := connection.recv(65536):
            answer += piece
    assert re.findall(rb"HTTP/1.1 (\d+)", answer) == [b"200", b"200", b"404"]
