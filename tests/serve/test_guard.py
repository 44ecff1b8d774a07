import http.client
import socket
import threading
import time
from contextlib import suppress

import pytest
from tests.serve.running import Client, form_of, photo, running
from tests.servers import PATIENCE

from zoedepth.depth_map import DepthMap
from zoedepth.predict import Predictor
from zoedepth.serve.guard import HEADERS, host_is_known
from zoedepth.serve.settings import Limits, Settings

TOKEN = "0123456789abcdef-token"
HEAD = b"POST /v1/depth HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/png\r\n"


def last_answer(connection: socket.socket) -> bytes:
    """Everything that comes until the other side closes the connection."""
    pieces = []
    while piece := connection.recv(65536):
        pieces.append(piece)
    return b"".join(pieces)


@pytest.mark.parametrize(
    ("host", "known"),
    [("localhost", True), ("127.0.0.1", True), ("192.168.1.7", True), ("[::1]", True), ("a.localhost", True),
     ("example.org", False), ("depth.example.org", True), ("DEPTH.example.org".lower(), True), ("", False),
     ("localhost.example.org", False), ("127.0.0.1.example.org", False), ("1.2.3", False)],
)  # fmt: skip
def test_only_names_that_nobody_else_can_point_here_are_known(host: str, known: bool) -> None:
    assert host_is_known(host, ("depth.Example.org",)) is known


@pytest.mark.parametrize("host", ["example.org", "example.org:8000", "localhost.example.org", ""])
def test_another_name_is_refused(host: str, client: Client) -> None:
    answer = client.ask("/v1/models", headers={"Host": host})
    assert (answer.status, answer.problem) == (421, "other-host")
    assert client.ask("/", headers={"Host": host}).status == 421
    assert client.ask("/healthz", headers={"Host": host}).status == 200  # a container checks itself by any name


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "https://example.org"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"},
     {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"}, {"Origin": "http://127.0.0.1:1"},
     {"Origin": "http://["}, {"Origin": "http://"}],
)  # fmt: skip
def test_pages_of_other_sites_are_refused(headers: dict[str, str], client: Client) -> None:
    for answer in (client.ask("/v1/models", headers=headers), client.ask("/v1/depth", photo(), headers=headers)):
        assert (answer.status, answer.problem) == (403, "other-origin")
        assert "access-control-allow-origin" not in answer.headers


def test_the_page_itself_may_ask(client: Client) -> None:
    own = {"Origin": f"http://127.0.0.1:{client.port}", "Sec-Fetch-Site": "same-origin"}
    assert client.ask("/v1/depth", photo(), headers=own).status == 200
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert client.ask("/", headers=link).status == 200


def test_a_token_is_asked_for_before_the_body_comes(model_file: str) -> None:
    with running(Settings((model_file,), token=TOKEN)) as client:
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {TOKEN}"}):
            answer = client.ask("/v1/depth", photo(), headers=headers)
            assert (answer.status, answer.problem) == (401, "token-needed")
            assert answer.headers["www-authenticate"].startswith("Bearer")
        assert client.ask("/metrics").status == 401
        for path in ("/", "/healthz", "/readyz", "/openapi.json"):
            assert client.ask(path).status == 200
        assert client.ask("/v1/depth", photo(), headers={"Authorization": f"bearer {TOKEN}"}).status == 200
        with client.connect() as connection:  # nothing of the body is sent
            connection.sendall(HEAD + b"Content-Length: 1000000\r\n\r\n")
            assert connection.recv(12) == b"HTTP/1.1 401"


def test_every_answer_has_the_headers_that_keep_browsers_out_of_trouble(client: Client) -> None:
    for answer in (client.ask("/"), client.ask("/v1/models"), client.ask("/x"), client.ask("/", headers={"Host": "a"})):
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS
        assert "server" not in answer.headers
    policy = HEADERS["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy.replace("wasm-unsafe-eval", "")
    assert "http" not in policy


def test_a_body_that_is_said_to_be_too_large_is_refused_before_it_comes(client: Client) -> None:
    with client.connect() as connection:
        connection.sendall(HEAD + b"Content-Length: 60000000\r\n\r\n")
        answer = connection.recv(65536)
        assert answer.startswith(b"HTTP/1.1 413")
        assert b"connection: close" in answer


def test_a_body_of_unknown_length_is_refused_as_it_becomes_too_large(model_file: str) -> None:
    piece = b"10000\r\n" + bytes(65536) + b"\r\n"
    sent = 0
    with running(Settings((model_file,), limits=Limits(max_body=2_000_000))) as client:
        with client.connect() as connection:
            connection.sendall(HEAD + b"Transfer-Encoding: chunked\r\n\r\n")
            with suppress(ConnectionError):  # the service closes the connection
                while sent < 40_000_000:
                    connection.sendall(piece)
                    sent += 65536
        # What is sent after the answer can tear it away, but the service counts how it has answered.
        deadline = time.monotonic() + PATIENCE
        while b'_requests_total{path="/v1/depth"' not in (numbers := client.ask("/metrics").body):
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert b'_requests_total{path="/v1/depth",status="413"} 1.0' in numbers
    # 2 MB are allowed, under 1 MB is read beyond, and the rest waits in the buffers of the system.
    assert sent < 20_000_000


def test_a_client_that_waits_for_our_word_sends_nothing_in_vain(client: Client) -> None:
    with client.connect() as connection:
        connection.sendall(HEAD + b"Expect: 100-continue\r\nContent-Length: 60000000\r\n\r\n")
        assert last_answer(connection).startswith(b"HTTP/1.1 413")


def test_a_refused_client_that_goes_on_sending_can_read_its_answer(client: Client) -> None:
    body, kind = form_of({"photo": bytes(700_000)})
    answer = client.ask("/v1/depth?domain=space", body, headers={"Content-Type": kind})
    assert answer.status == 422


def test_slow_bodies_are_cut_off(model_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoedepth.serve.guard._FREE_SECONDS", 0.1)
    monkeypatch.setattr("zoedepth.serve.guard._LINGER", 0.1)
    with running(Settings((model_file,))) as client, client.connect() as connection:
        connection.sendall(HEAD + b"Content-Length: 1000\r\n\r\n" + b"x" * 10)
        answer = last_answer(connection)
        assert answer.startswith(b"HTTP/1.1 408")
        assert b"slow-body" in answer


def test_too_many_uploads_and_too_many_bytes_are_refused(model_file: str) -> None:
    limits = Limits(max_uploads=1, max_held=1000)
    with running(Settings((model_file,), limits=limits)) as client:
        assert client.ask("/v1/depth", bytes(2000)).problem == "busy"
        with client.connect() as connection:
            connection.sendall(HEAD + b"Content-Length: 100\r\n\r\n")
            deadline = time.monotonic() + PATIENCE
            while (answer := client.ask("/v1/depth", b"x")).status != 429:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            assert answer.problem == "busy"
            assert int(answer.headers["retry-after"]) > 0
        while client.ask("/v1/depth", b"x").status == 429:  # until the service sees that the other one has gone
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert client.ask("/v1/depth", b"x").status == 415


def test_where_the_queue_is_full_a_photo_is_refused_before_its_body_comes(
    model_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()
    batch = Predictor.batch

    def held(self: Predictor, images: list, **options: object) -> list[DepthMap]:
        begun.set()
        assert go_on.wait(PATIENCE)
        return batch(self, images, **options)

    monkeypatch.setattr(Predictor, "batch", held)
    with running(Settings((model_file,), threads=1, limits=Limits(queue=0))) as client:
        statuses: list[int] = []
        first = threading.Thread(target=lambda: statuses.append(client.ask("/v1/depth", photo()).status))
        first.start()
        assert begun.wait(PATIENCE)
        with client.connect() as connection:
            connection.sendall(HEAD + b"Content-Length: 1000\r\n\r\n")
            answer = connection.recv(65536)
        assert answer.startswith(b"HTTP/1.1 429")
        assert b"retry-after: " in answer
        assert client.ask("/v1/models").status == 200
        go_on.set()
        first.join()
        assert statuses == [200]


def test_what_is_held_is_let_go(client: Client) -> None:
    for body in (photo(), bytes(100_000), b""):
        client.ask("/v1/depth", body)
    guard = client.service._guard
    assert guard._held == 0
    assert guard._n_uploads == 0


def test_one_connection_takes_many_requests(client: Client) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=PATIENCE)
    for _ in range(3):
        connection.request("POST", "/v1/depth", photo(), {"Content-Type": "image/png"})
        response = connection.getresponse()
        assert response.status == 200
        response.read()
    connection.close()
