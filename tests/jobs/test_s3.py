"""A store like S3, moto's server, in and out: also where it fails now and then, is slow, or goes away."""

import time
from collections.abc import Iterator
from pathlib import Path
from threading import Lock

import pytest
from tests.jobs.photos import contents, run, write_photos

from zoedepth.errors import InputError
from zoedepth.jobs import origins
from zoedepth.jobs.report import read_status
from zoedepth.jobs.run import Tally

pytest.importorskip("moto", reason="moto is not installed")
s3fs = pytest.importorskip("s3fs", reason="the extra [cloud] is not installed")


class Trouble:
    """A layer around the server that fails and waits as it is told."""

    def __init__(self, application: object) -> None:
        self.application, self.lock = application, Lock()
        self.every = 0
        """One of so many requests of photos and files gets "503 Slow Down"; 0: none."""
        self.gone = False
        """No file is taken any more."""
        self.wait = 0.0
        self.n_requests = 0

    def __call__(self, environ: dict[str, str], start_response: object) -> object:
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        with self.lock:
            self.n_requests += 1
            fails = self.every and path.endswith((".png", ".npy", ".json")) and self.n_requests % self.every == 0
        time.sleep(self.wait)
        if fails or (self.gone and method == "PUT" and "manifest" not in path):
            start_response("503 Slow Down", [("Content-Type", "application/xml")])
            return [b"<Error><Code>SlowDown</Code><Message>Please reduce your request rate.</Message></Error>"]
        return self.application(environ, start_response)


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[str, Trouble]]:
    from threading import Thread

    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    trouble = Trouble(DomainDispatcherApplication(create_backend_app))
    server = make_server("127.0.0.1", 0, trouble, threaded=True)
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", trouble
    server.shutdown()
    thread.join()


@pytest.fixture
def trouble(server: tuple[str, Trouble], monkeypatch: pytest.MonkeyPatch) -> Trouble:
    url, trouble = server
    trouble.every, trouble.gone, trouble.wait = 0, False, 0.0
    for name, value in {
        "AWS_ENDPOINT_URL": url, "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1", "AWS_MAX_ATTEMPTS": "1",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(origins, "_FIRST_WAIT", 0.001)
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 1)
    s3fs.S3FileSystem.clear_instance_cache()
    return trouble


def fill(folder: Path, bucket: str) -> str:
    """Put the photos of a folder into a new bucket, and return their prefix."""
    store = s3fs.S3FileSystem()
    store.mkdir(bucket)
    for file in folder.rglob("*.png"):
        store.pipe_file(f"{bucket}/in/{file.relative_to(folder).as_posix()}", file.read_bytes())
    return f"s3://{bucket}/in"


def stored(bucket: str) -> dict[str, bytes]:
    store = s3fs.S3FileSystem()
    return {
        name.removeprefix(f"{bucket}/out/"): store.cat_file(name)
        for name in store.find(f"{bucket}/out")
        if "manifest" not in name
    }


def test_in_and_out_with_failing_and_slow_requests(tmp_path: Path, trouble: Trouble) -> None:
    photos = write_photos(tmp_path / "in", 4)
    source = fill(photos, "first")
    trouble.every, trouble.wait = 5, 0.002
    results, tally = run(source, out="s3://first/out", workers=2)
    assert [done.entry.error for done in results] == [None] * 4
    assert (tally.done, tally.failed) == (4, 0)
    trouble.every = 0
    run(photos, out=tmp_path / "expected")
    expected, found = contents(tmp_path / "expected"), stored("first")
    assert found.keys() == expected.keys()
    assert all(found[name] == expected[name] for name in found if not name.endswith(".json"))
    assert run(source, out="s3://first/out")[1].before == 4
    (status,) = read_status("s3://first/out")
    assert (status.done, status.failed) == (4, 0)


def test_a_store_that_goes_away_and_comes_back(tmp_path: Path, trouble: Trouble) -> None:
    source = fill(write_photos(tmp_path / "in", 3), "second")

    def go(_: object) -> None:
        trouble.gone = True

    with pytest.raises(InputError, match="nothing more can be written to s3://second/out"):
        run(source, out="s3://second/out", at=go)
    trouble.gone = False
    _, tally = run(source, out="s3://second/out")
    assert (tally.done + tally.before, tally.failed) == (3, 0)
    assert len(stored("second")) == 9


def test_two_commands_at_once(tmp_path: Path, trouble: Trouble) -> None:
    """Amazon's servers, and moto's, refuse a second object of the same name if they are asked to."""
    source = fill(write_photos(tmp_path / "in", 3), "third")
    second: list[Tally] = []

    def again(_: object) -> None:
        if not second:
            second.append(run(source, out="s3://third/out")[1])

    with pytest.raises(InputError, match=r"s3://third/out/zoedepth-manifest cannot .* has begun on it since"):
        run(source, out="s3://third/out", at=again)
    assert second[0].done == 3
    assert run(source, out="s3://third/out")[1].before == 3
