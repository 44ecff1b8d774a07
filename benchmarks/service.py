"""The service under load: ``python -m benchmarks.service [speed|hostile]``. A process of `zoedepth serve` is started.

    python -m benchmarks.service speed --requests 64
    python -m benchmarks.service hostile --requests 10000 --clients 200

speed: seconds that clients wait, and photos a second, for 1, 4, 16 and 64 clients, and for one-by-one calls of
``Predictor`` in this process, in turn. hostile: three requests of ten are no honest ones. All honest ones must get the
bytes that `zoedepth predict` writes, all others a refusal, and the service must hold no more memory at the end than it
did after a tenth of the requests.
"""

import argparse
import io
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image

from zoedepth.config import INDOOR, OUTDOOR, AttractorConfig, DecoderConfig, EncoderConfig, ModelConfig, RouterConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

CLIENTS = (1, 4, 16, 64)
HONEST = 0.7
"""Share of honest requests in a hostile run."""
ALLOWED_GROWTH = 0.05
"""Growth of memory from the first tenth of the requests to the last."""


class Service(NamedTuple):
    """A process that serves."""

    port: int
    process: subprocess.Popen[str]

    @property
    def memory(self) -> int:
        """Bytes of memory that it holds."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return 1024 * int(re.search(r"VmRSS:\s*(\d+)", status)[1])

    @property
    def n_files(self) -> int:
        """Files and connections that it has open."""
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    @property
    def seconds(self) -> float:
        """Seconds of a core that it has used."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def serving(model: str, *options: str) -> Iterator[Service]:
    """Start `zoedepth serve` with a model until the block ends."""
    command = [sys.executable, "-m", "zoedepth", "serve", "--port", "0", "--model", model, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        found = re.search(r":(\d+)/", process.stdout.readline())
        if found is None:
            raise SystemExit("the service did not start")
        service = Service(int(found[1]), process)
        while ask(service.port, "/readyz", None)[0] != 200:
            time.sleep(0.1)
        yield service
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def ask(port: int, path: str, body: bytes | None, **headers: str) -> tuple[int, bytes]:
    """Send a request; returns the status and the body of the answer, 0 where the service is not there yet."""
    connection = HTTPConnection("127.0.0.1", port, timeout=120)
    try:
        given = {"Content-Type": "image/jpeg"} | {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request("GET" if body is None else "POST", path, body, given)
        answer = connection.getresponse()
        return answer.status, answer.read()
    except ConnectionRefusedError:
        return 0, b""
    finally:
        connection.close()


def photo(width: int, height: int, *, seed: int) -> bytes:
    """Return a JPEG of smooth noise."""
    values = np.random.default_rng(seed).integers(0, 256, (height // 16 + 1, width // 16 + 1, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(values).resize((width, height), Image.Resampling.BICUBIC).save(file, "JPEG", quality=90)
    return file.getvalue()


def expected(predictor: Predictor, content: bytes) -> bytes:
    """Return the PNG that `zoedepth predict` writes for a photo."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "depth.png")
        predictor(io.BytesIO(content)).save(path)
        return path.read_bytes()


def speed(model: str, n_requests: int) -> int:
    """Print how long clients wait, and how many photos are answered in a second."""
    photos = [photo(640, 480, seed=seed) for seed in range(8)]
    predictor = Predictor(load_model(model))
    expected(predictor, photos[0])
    rows: list[tuple[str, list[float], float, int]] = []
    with serving(model) as service:
        for content in photos[:4]:
            ask(service.port, "/v1/depth", content)
        for n_clients in CLIENTS:
            started = time.perf_counter()
            alone = [_timed(lambda content=content: expected(predictor, content)) for content in photos]
            rows.append(("one by one, Predictor", alone, time.perf_counter() - started, 0))
            seconds, refused = [], Counter[int]()
            started = time.perf_counter()
            _all_at_once(n_clients, max(n_requests, 2 * n_clients), lambda number, refused=refused, seconds=seconds: (
                _ask_timed(service.port, photos[number % len(photos)], seconds, refused)
            ))  # fmt: skip
            rows.append((f"{n_clients} clients", seconds, time.perf_counter() - started, refused.total()))
    print(f"photos of 640 x 480, {model}, {torch.get_num_threads()} threads here, {os.cpu_count()} cores")
    print(f"{'':<24}{'p50':>9}{'p95':>9}{'p99':>9}{'photos/s':>10}{'refused':>9}")
    for name, seconds, total, n_refused in rows:
        values = [1000 * float(np.percentile(seconds, share)) for share in (50, 95, 99)] if seconds else [np.nan] * 3
        print(f"{name:<24}" + "".join(f"{value:>6.0f} ms" for value in values)
              + f"{len(seconds) / total:>10.2f}{n_refused:>9}")  # fmt: skip
    return 0


def _timed(function: Callable[[], object]) -> float:
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


def _ask_timed(port: int, content: bytes, seconds: list[float], refused: Counter[int]) -> None:
    started = time.perf_counter()
    status, _ = ask(port, "/v1/depth", content)
    if status == 200:
        seconds.append(time.perf_counter() - started)
    else:
        refused[status] += 1


def _all_at_once(n_clients: int, n_requests: int, send: Callable[[int], object]) -> None:
    """Call ``send`` with the number of each request, in as many threads as there are clients."""
    numbers, lock = iter(range(n_requests)), threading.Lock()

    def client() -> None:
        while True:
            with lock:
                number = next(numbers, None)
            if number is None:
                return
            send(number)

    threads = [threading.Thread(target=client) for _ in range(n_clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


# ---- hostile clients. Each returns what it got: a status, or 0 for a closed connection.

HEAD = b"POST /v1/depth HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/jpeg\r\n"


def _zeros(mebibytes: int) -> bytes:
    packer = zlib.compressobj(9)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(mebibytes)) + packer.flush()


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _png(width: int, height: int, *further: bytes, rows: bytes = b"") -> bytes:
    header = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(further) + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def _saved(format: str, **options: object) -> bytes:
    frames = [Image.fromarray(np.full((48, 64, 3), value, np.uint8)) for value in (40, 200)]
    file = io.BytesIO()
    frames[0].save(file, format, **options | ({"append_images": frames[1:]} if options.get("save_all") else {}))
    return file.getvalue()


def _bodies() -> dict[str, tuple[bytes, tuple[int, ...]]]:
    """Return bodies that are no photos → the statuses that they may get."""
    good, zeros = photo(64, 48, seed=0), _zeros(64)
    large = io.BytesIO()
    Image.new("L", (12_000, 9_000)).save(large, "PNG")
    return {
        "not an image": (b"hello, world" * 100, (415,)),
        "a web page": (b"<html><script>alert(1)</script></html>", (415,)),
        "a program": (b"\x7fELF" + bytes(5000), (415,)),
        "an archive": (b"PK\3\4" + bytes(5000), (415,)),
        "an svg": (b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>', (415,)),
        "a film": (b"\0\0\0\x18ftypmp42" + bytes(5000), (415,)),
        "polyglot page and photo": (b"<html></html>" + good, (415,)),
        "polyglot pdf and photo": (b"%PDF-1.7\n" + good, (415,)),
        "cut short": (good[: len(good) // 3], (422,)),
        "damaged": (good[:200] + bytes(300) + good[500:600], (422,)),
        "png bomb": (_png(30_000, 30_000, rows=zeros), (413, 422)),
        "png bomb within the pixels": (_png(7000, 7000, rows=zeros), (422,)),
        "png of many chunks": (_png(9, 9, *[_chunk(b"aaAa", b"")] * 15_000), (422,)),
        "png with a text bomb": (_png(9, 9, _chunk(b"zTXt", b"a\0\0" + zeros)), (422,)),
        "too many pixels": (large.getvalue(), (413,)),
        "gif bomb": (b"GIF89a" + struct.pack("<HH", 65535, 65535) + bytes(50), (413, 422)),
        "bmp bomb": (b"BM" + struct.pack("<IHHIIiiHHI", 60, 0, 0, 54, 40, 60_000, 60_000, 1, 8, 1), (413, 422)),
        "tiff in a circle": (b"II*\0\x08\0\0\0" + struct.pack("<HHHIII", 1, 256, 4, 1, 9, 8), (422,)),
        "jpeg of many segments": (b"\xff\xd8" + b"\xff\xe1\0\2" * 30_000, (422,)),
        "webp cut short": (_saved("WEBP")[:40], (422,)),
        "avif cut short": (_saved("AVIF")[:200], (422,)),
        "animation": (_saved("GIF", save_all=True), (422,)),
        "several pages": (_saved("TIFF", save_all=True), (422,)),
        "empty": (b"", (422,)),
    }  # fmt: skip


def _raw(port: int, *pieces: bytes, pause: float = 0.0, listen: bool = True) -> int:
    """Send bytes as they are; returns the status of the answer, 0 where none comes."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        with suppress(OSError):
            for piece in pieces:
                connection.sendall(piece)
                time.sleep(pause)
        if listen:
            found = re.match(rb"HTTP/1.1 (\d+)", connection.recv(4096))
            return int(found[1]) if found else 0
    return 0


def _manners(port: int) -> dict[str, tuple[Callable[[], int], tuple[int, ...]]]:
    """Return what clients do that have no manners → the statuses that they may get; 0: no answer."""
    good = photo(64, 48, seed=0)
    length = b"Content-Length: %d\r\n\r\n"

    def status(path: str, body: bytes | None, **headers: str) -> int:
        with suppress(HTTPException, OSError):
            return ask(port, path, body, **headers)[0]
        return 0

    def form(content: bytes) -> int:
        return status("/v1/depth", content, Content_Type="multipart/form-data; boundary=x")

    chunk = b"100000\r\n" + bytes(1 << 20) + b"\r\n"
    field = b'--x\r\nContent-Disposition: form-data; name="%s"\r\n\r\n'
    return {
        "says it is huge": (lambda: _raw(port, HEAD, length % 10**9), (413,)),
        "is huge, in pieces": (
            lambda: _raw(port, HEAD, b"Transfer-Encoding: chunked\r\n\r\n", *[chunk] * 55),
            (413, 429, 0),
        ),
        "sends less than it says": (lambda: _raw(port, HEAD, length % 5000, good[:1000], listen=False), (0,)),
        "sends more than it says": (lambda: _raw(port, HEAD, length % 1000, good), (422, 429)),
        "says no number": (lambda: _raw(port, HEAD, b"Content-Length: many\r\n\r\n"), (400,)),
        "says a negative number": (lambda: _raw(port, HEAD, b"Content-Length: -5\r\n\r\n"), (400,)),
        "says two lengths": (lambda: _raw(port, HEAD, b"Content-Length: 5\r\n", length % 6), (400,)),
        "hangs up at once": (lambda: _raw(port, HEAD, length % len(good), good, listen=False), (0,)),
        "sends slowly and hangs up": (
            lambda: _raw(port, HEAD, length % 50, *[b"x"] * 8, pause=0.2, listen=False), (0,),
        ),
        "speaks no HTTP": (lambda: _raw(port, os.urandom(500), b"\r\n\r\n"), (400,)),
        "sends a broken form": (lambda: form(b"--x\r\nContent-Disposition"), (400, 429)),
        "sends a form without a photo": (lambda: form(field % b"points" + b"[]\r\n--x--\r\n"), (422, 429)),
        "asks for a path": (lambda: form(field % b"path" + b"/etc/passwd\r\n--x--\r\n"), (422, 429)),
        "climbs out of the page": (lambda: status("/../../etc/passwd", None), (404,)),
        "asks for another format": (lambda: status("/v1/depth?format=exe", good), (422,)),
        "makes up parameters": (lambda: status("/v1/depth?path=/etc/passwd", good), (422,)),
        "calls another host": (lambda: status("/v1/models", None, Host="example.org"), (421,)),
        "is a page of another site": (lambda: status("/v1/depth", good, Origin="https://example.org"), (403,)),
    }  # fmt: skip


def hostile(model: str, n_requests: int, n_clients: int) -> int:
    """Send honest and hostile requests from many clients; returns 1 if anything goes wrong."""
    with tempfile.TemporaryDirectory() as folder:
        if model == "tiny":
            model = _tiny(Path(folder, "tiny.safetensors"))
        predictor = Predictor(load_model(model))
        photos = [photo(64 + 16 * number, 48 + 8 * number, seed=number) for number in range(6)]
        answers = [expected(predictor, content) for content in photos]
        with serving(model) as service:
            return _attack(service, photos, answers, n_requests, n_clients)


def _attack(service: Service, photos: list[bytes], answers: list[bytes], n_requests: int, n_clients: int) -> int:
    port, dice = service.port, random.Random(0)
    bodies, manners = _bodies(), _manners(port)
    plan = [
        dice.randrange(len(photos)) if dice.random() < HONEST else dice.choice([*bodies, *manners])
        for _ in range(n_requests)
    ]
    wrong, counted, memory = Counter[str](), Counter[str](), dict[int, int]()
    done, lock = [0], threading.Lock()
    files_before = service.n_files

    def honest(number: int) -> None:
        for _ in range(10_000):
            status, body = ask(port, "/v1/depth", photos[number])
            if status not in (429, 503):
                break
            counted[f"told to come again ({status})"] += 1
            time.sleep(random.uniform(0.2, 1))
        counted["honest"] += 1
        if status != 200 or body != answers[number]:
            wrong[f"an honest request got {status}, or another depth"] += 1

    def send(number: int) -> None:
        what = plan[number]
        try:
            if isinstance(what, int):
                honest(what)
            elif what in bodies:
                body, allowed = bodies[what]
                while (status := ask(port, "/v1/depth", body)[0]) in (429, 503):
                    time.sleep(random.uniform(0.2, 1))
                counted[f"hostile, {status}"] += 1
                if status not in allowed:
                    wrong[f"{what}: {status}"] += 1
            else:
                function, allowed = manners[what]
                status = function()
                counted[f"hostile, {status or 'no answer'}"] += 1
                if status not in (*allowed, 429, 503):
                    wrong[f"{what}: {status}"] += 1
        except (OSError, HTTPException) as error:
            wrong[f"{what}: {type(error).__name__}"] += 1
        with lock:
            done[0] += 1
            if done[0] in (n_requests // 10, n_requests):
                memory[done[0]] = service.memory

    started = time.perf_counter()
    _all_at_once(n_clients, n_requests, send)
    total = time.perf_counter() - started
    time.sleep(3)
    before = service.seconds
    time.sleep(3)
    idle = (service.seconds - before) / 3
    growth = memory[n_requests] / memory[n_requests // 10] - 1
    print(f"{n_requests} requests of {n_clients} clients in {total:.0f} s")
    for name, number in sorted(counted.items()):
        print(f"  {name:<28}{number:>7}")
    print(f"memory after {n_requests // 10}: {memory[n_requests // 10] / 1e6:.0f} MB, after {n_requests}: "
          f"{memory[n_requests] / 1e6:.0f} MB ({growth:+.1%})")  # fmt: skip
    print(f"afterwards: {idle:.1%} of a core, {service.n_files} open files ({files_before} before)")
    if growth > ALLOWED_GROWTH:
        wrong[f"memory grew by {growth:.1%}"] += 1
    if idle > 0.1:
        wrong["it is not idle"] += 1
    if service.n_files > files_before + 5:
        wrong["files or connections are left open"] += 1
    if ask(port, "/v1/depth", photos[0])[1] != answers[0]:
        wrong["it does not answer any more"] += 1
    for name, number in wrong.most_common():
        print(f"WRONG {number:>5}  {name}")
    return 1 if wrong else 0


def _tiny(path: Path) -> str:
    """Write a tiny random model, with which the service has more to do than the model; returns its path."""
    config = ModelConfig(
        EncoderConfig("beit_base_patch16_384", "beit", size=(64, 64), taps=(0, 1, 2, 3), channels=(8, 16, 16, 16),
                      width=32, depth=(4,), heads=(4,)),
        decoder=DecoderConfig(widths=(16, 16, 16, 16), features=8),
        head=AttractorConfig(8, n_attractors=(4, 3, 2, 1), embedding_width=16, projector_width=16, seed_width=16),
        router=RouterConfig("trained", classifier="mlp", width=16),
        domains=(INDOOR, OUTDOOR),
        size=(64, 64),
    )  # fmt: skip
    torch.manual_seed(0)
    save_model(ZoeDepth(config).eval(), path)
    return str(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["speed", "hostile"], nargs="?", default="speed")
    parser.add_argument("--model", help="model to serve; hostile takes a tiny random one without it")
    parser.add_argument("--requests", type=int)
    parser.add_argument("--clients", type=int, default=200)
    options = parser.parse_args()
    if options.what == "speed":
        return speed(options.model or "zoed-lite", options.requests or 64)
    return hostile(options.model or "tiny", options.requests or 10_000, options.clients)


if __name__ == "__main__":
    sys.exit(main())
