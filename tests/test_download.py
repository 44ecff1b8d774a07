"""Downloads from a real server: whole or not at all, taken up where they stopped."""

import errno
import hashlib
import os
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPResponse
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from urllib.request import Request, urlopen

import numpy as np
import pytest
from tests.servers import PATIENCE, FileServer

from zoedepth.download import TIMEOUT, cache_home, download, version_of
from zoedepth.errors import InputError

CONTENT = np.random.default_rng(0).bytes(300_000)
OTHER = np.random.default_rng(1).bytes(300_000)


class TestCacheHome:
    @pytest.fixture(autouse=True)
    def clean(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        (tmp_path / "temporary").mkdir()
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))

    def test_is_the_users(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("HOME", str(tmp_path))
        assert cache_home() == tmp_path / ".cache"
        monkeypatch.setenv("XDG_CACHE_HOME", "~/mine")
        assert cache_home() == tmp_path / "mine"

    def test_without_a_home_it_is_temporary(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A container's user whose number has no name: Python leaves "~" as it is."""
        monkeypatch.setattr(os.path, "expanduser", lambda path: path)
        assert cache_home().parent == Path(tempfile.gettempdir())

    def test_with_a_home_that_cannot_be_written_to_it_is_temporary(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("HOME", str(tmp_path))
        monkeypatch.setattr(os, "access", lambda *_: False)
        assert cache_home().parent == Path(tempfile.gettempdir())
        (tmp_path / ".cache").mkdir()  # somebody has filled it before the disk became read-only
        assert cache_home() == tmp_path / ".cache"

    # The test is of owners and modes as POSIX has them. On Windows the folder for temporary files is the user's own.
    @pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no owners and modes of this kind")
    def test_a_temporary_one_is_for_the_user_alone(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os.path, "expanduser", lambda path: path)
        umask = os.umask(0)
        try:
            folder = cache_home()
        finally:
            os.umask(umask)
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert cache_home() == folder
        folder.chmod(0o755)
        assert cache_home() == folder, "others may read it"

    # The test is of owners and modes as POSIX has them. On Windows the folder for temporary files is the user's own.
    @pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no owners and modes of this kind")
    @pytest.mark.parametrize(
        ("made", "problem"),
        [("link", "is a link"), ("open", "can be written to by other users"), ("theirs", "belongs to another user")],
    )
    def test_one_that_somebody_else_has_made_is_refused(
        self, made: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(os.path, "expanduser", lambda path: path)
        folder = tmp_path / "temporary" / f"zoedepth-{os.getuid() + (made == 'theirs')}"
        if made == "link":
            (tmp_path / "elsewhere").mkdir(mode=0o700)
            folder.symlink_to(tmp_path / "elsewhere")
        else:
            folder.mkdir()
            folder.chmod(0o777 if made == "open" else 0o700)
        if made == "theirs":  # the folder is this user's, and the name is that of the user who asks
            another = os.getuid() + 1
            monkeypatch.setattr(os, "getuid", lambda: another)
        with pytest.raises(InputError, match=rf"{folder}, .* {problem}.*XDG_CACHE_HOME.*HF_HOME"):
            cache_home()
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "mine"))
        assert cache_home() == tmp_path / "mine"


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS])
def test_folder_that_cannot_be_written_to_is_named_with_the_way_out(
    number: int, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number), str(path.parent))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(InputError, match=f"to {path.parent}: .*XDG_CACHE_HOME"):
        download("http://localhost/model.safetensors", path)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def server() -> Iterator[FileServer]:
    with FileServer(CONTENT) as server:
        yield server


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "weights" / "model.safetensors"


def names(path: Path) -> list[str]:
    return sorted(file.name for file in path.parent.iterdir())


def cut(server: FileServer, path: Path, *, after: int = 100_000) -> None:
    """A download whose connection is cut after ``after`` bytes."""
    server.stop_after = after
    with pytest.raises(InputError, match=rf"stopped after {after:,} of 300,000 bytes .*typing the command again"):
        download(server.url, path)
    server.stop_after = None
    assert not path.exists()
    assert path.with_name("model.safetensors.part").stat().st_size == after


# --- whole ------------------------------------------------------------------------------------------------------------


def test_file_arrives_whole_and_leaves_nothing_beside_it(server: FileServer, path: Path):
    assert download(f"{server.url}/some/model.safetensors", path, sha256=sha256(CONTENT).upper()) == path
    assert path.read_bytes() == CONTENT
    assert names(path) == [path.name]


def test_version_changes_with_what_the_server_says(server: FileServer):
    server.etag = '"first"'
    first = version_of(server.url)
    assert first is not None
    assert version_of(server.url) == first
    server.etag = '"second"'
    assert version_of(server.url) not in (None, first)
    server.etag, server.length, server.ranges = None, False, False
    assert version_of(server.url) is None
    server.close()
    assert version_of(server.url) is None


def test_file_that_exists_is_returned_untouched_without_network(server: FileServer, path: Path):
    path.parent.mkdir()
    path.write_bytes(b"mine")
    assert download(server.url, path, sha256=sha256(CONTENT)) == path
    assert path.read_bytes() == b"mine"
    assert server.requests == []


def test_answer_without_a_length_is_taken_as_it_is(server: FileServer, path: Path):
    server.length = False
    assert download(server.url, path).read_bytes() == CONTENT


def test_empty_file(server: FileServer, path: Path):
    server.content = b""
    assert download(server.url, path).read_bytes() == b""


def test_progress_is_told_from_the_first_byte_to_the_last(server: FileServer, path: Path, capfd):
    told = []
    download(server.url, path, name="ZoeD", progress=lambda *now: told.append(now))
    assert {(name, total) for name, _, total in told} == {("ZoeD", 300_000)}
    done = [done for _, done, _ in told]
    assert done[0] == 0
    assert done[-1] == 300_000
    assert done == sorted(done)
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_progress_goes_on_where_the_download_stopped(server: FileServer, path: Path):
    told = []
    cut(server, path)
    download(server.url, path, progress=lambda *now: told.append(now))
    assert told[0] == (path.name, 100_000, 300_000)
    assert told[-1] == (path.name, 300_000, 300_000)


def test_progress_of_a_file_of_unknown_length_has_no_total(server: FileServer, path: Path):
    server.length = False
    told = []
    download(server.url, path, progress=lambda *now: told.append(now))
    assert told[-1] == (path.name, 300_000, None)


def test_large_download_without_a_callback_is_logged_and_a_small_one_is_not(
    server: FileServer, path: Path, caplog: pytest.LogCaptureFixture
):
    """So that somebody who calls from Python sees what it waits for."""
    download(server.url, path)
    assert caplog.records == []
    server.content = bytes(2_000_000)
    large = path.with_name("large")
    download(server.url, large, name="ZoeD")
    download(server.url, path.with_name("other"), progress=lambda *_: None)
    (record,) = caplog.records
    assert (record.name, record.levelname) == ("zoedepth", "WARNING")
    assert record.getMessage() == f"downloading ZoeD (2 MB) from {server.url} to {large}"


# --- taken up ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("etag", "modified"), [('"first"', None), (None, 1e9), ('"first"', 1e9)])
def test_cut_download_goes_on_where_it_stopped(
    server: FileServer, path: Path, etag: str | None, modified: float | None
):
    server.etag, server.modified = etag, modified
    cut(server, path)
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None, "bytes=100000-"]
    assert names(path) == [path.name]


def test_download_cut_twice_goes_on_twice(server: FileServer, path: Path):
    server.stop_after = 100_000
    for _ in range(2):
        with pytest.raises(InputError, match="goes on from there"):
            download(server.url, path)
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None, "bytes=100000-", "bytes=200000-"]


def test_server_that_ignores_ranges_sends_all_again(server: FileServer, path: Path):
    cut(server, path)
    server.ranges = False
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None, "bytes=100000-"]


@pytest.mark.parametrize("length", [50_000, 200_000, 300_000, 400_000])
def test_file_that_changed_between_attempts_is_started_over(server: FileServer, path: Path, length: int):
    """Also when it is as long as before, as the weights of one architecture are, and when it ends before the part."""
    cut(server, path)
    server.content = (OTHER + OTHER)[:length]
    server.etag = '"second"'
    assert download(server.url, path).read_bytes() == server.content


def test_file_of_another_length_is_started_over_whatever_its_tag_says(server: FileServer, path: Path):
    cut(server, path)
    server.content = OTHER[:200_000]
    assert download(server.url, path).read_bytes() == server.content


def test_part_from_another_address_is_started_over(server: FileServer, path: Path):
    cut(server, path)
    server.content = OTHER
    assert download(f"{server.url}/other", path).read_bytes() == OTHER


def test_part_of_an_untagged_file_is_used_only_if_a_hash_can_check_it(server: FileServer, path: Path):
    server.etag, server.stop_after = None, 100_000
    with pytest.raises(InputError, match="starts over"):
        download(server.url, path)
    with pytest.raises(InputError, match="goes on from there"):
        download(server.url, path, sha256=sha256(CONTENT))
    server.stop_after = None
    assert download(server.url, path, sha256=sha256(CONTENT)).read_bytes() == CONTENT
    assert server.requests == [None, None, "bytes=100000-"]


def test_part_of_unknown_origin_is_not_used(server: FileServer, path: Path):
    path.parent.mkdir()
    path.with_name(f"{path.name}.part").write_bytes(OTHER[:1000])
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None]


def test_part_that_is_complete_needs_no_network(server: FileServer, path: Path, monkeypatch: pytest.MonkeyPatch):
    """Stopped between the last byte and the renaming."""

    def fail(self: Path, target: Path) -> Path:
        raise OSError("no renaming today")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with pytest.raises(InputError, match="no renaming today"):
            download(server.url, path)
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_interrupted_process_leaves_its_part_and_no_lock(server: FileServer, path: Path, number: signal.Signals):
    server.stop_after, server.stall = 200_000, Event()
    code = "import pathlib, sys, zoedepth.download as d; d.download(sys.argv[1], pathlib.Path(sys.argv[2]))"
    process = subprocess.Popen([sys.executable, "-c", code, server.url, path], stderr=subprocess.DEVNULL)
    part, deadline = path.with_name(f"{path.name}.part"), time.monotonic() + PATIENCE
    while not (part.exists() and part.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(number)
    assert process.wait() != 0  # -number, but for an interrupt that Python meets while it handles another exception
    server.stall.set()
    server.stop_after = None
    assert not path.exists()
    length = part.stat().st_size
    assert 0 < length <= 200_000
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None, f"bytes={length}-"]


# --- together ---------------------------------------------------------------------------------------------------------


def test_downloads_at_the_same_time_share_one(server: FileServer, path: Path):
    with ThreadPoolExecutor(8) as pool:
        paths = list(pool.map(lambda _: download(server.url, path), range(8)))
    assert paths == [path] * 8
    assert path.read_bytes() == CONTENT
    assert names(path) == [path.name]
    assert server.requests == [None]


# --- refused ----------------------------------------------------------------------------------------------------------


def test_wrong_hash_deletes_what_arrived_and_shows_both(server: FileServer, path: Path):
    with pytest.raises(InputError, match=f"{sha256(CONTENT)}, expected {sha256(OTHER)}") as caught:
        download(server.url, path, sha256=sha256(OTHER))
    assert server.url in str(caught.value)
    assert not path.exists()
    assert not any(name.endswith((".part", ".json")) for name in names(path))
    assert download(server.url, path, sha256=sha256(CONTENT)).read_bytes() == CONTENT
    assert server.requests == [None, None]


@pytest.mark.parametrize("status", [401, 404, 500, 503])
def test_refusal_names_the_address_and_the_other_way(server: FileServer, path: Path, status: int):
    server.status = status
    refusal = rf"model.safetensors from {server.url}: HTTP Error {status}.* put it at {path}"
    with pytest.raises(InputError, match=refusal):
        download(server.url, path)
    assert not path.exists()


def test_refusal_keeps_the_part(server: FileServer, path: Path):
    cut(server, path)
    server.status = 503
    with pytest.raises(InputError, match="503"):
        download(server.url, path)
    server.status = 200
    assert download(server.url, path).read_bytes() == CONTENT
    assert server.requests == [None, "bytes=100000-", "bytes=100000-"]


def test_server_that_is_not_there(path: Path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, but nobody listens
        url = f"http://127.0.0.1:{taken.getsockname()[1]}/model"
        with pytest.raises(InputError, match=rf"{url}: .*refused.* put it at {path}"):
            download(url, path)


def test_silent_server_is_given_up(server: FileServer, path: Path, monkeypatch: pytest.MonkeyPatch):
    """The patience is shortened after the server has answered, which may take its time on a busy machine."""

    def impatient(request: Request, *, timeout: float) -> HTTPResponse:
        assert timeout == TIMEOUT
        response = urlopen(request, timeout=timeout)
        response.fp.raw._sock.settimeout(0.1)
        return response

    monkeypatch.setattr("zoedepth.download.urlopen", impatient)
    server.stop_after, server.stall = 100_000, Event()
    with pytest.raises(InputError, match=r"stopped after [\d,]+ of 300,000 bytes \(.*timed out\)"):
        download(server.url, path)


@pytest.mark.parametrize("url", ["ftp://host/model", "file:///etc/hostname", "model.safetensors", "", "httpx://host"])
def test_other_kinds_of_address_are_refused(path: Path, url: str):
    with pytest.raises(InputError, match="must begin with http"):
        download(url, path)
    assert not path.parent.exists()


@pytest.mark.parametrize("url", ["http://", "http://[::1/model", "http://host:port/model", "http://127.0.0.1/a b"])
def test_broken_address_is_refused(path: Path, url: str):
    with pytest.raises(InputError, match="cannot download"):
        download(url, path)


def test_page_in_place_of_the_file_is_refused(server: FileServer, path: Path):
    server.content, server.content_type = b"<html>Please log in</html>", "text/html; charset=utf-8"
    with pytest.raises(InputError, match="web page"):
        download(server.url, path)
    assert not path.exists()


def test_full_disk_is_noticed_before_anything_is_written(
    server: FileServer, path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=250_000))
    with pytest.raises(InputError, match=r"250,000 bytes free, and model\.safetensors needs 300,000"):
        download(server.url, path)
    assert not path.with_name(f"{path.name}.part").exists()


def test_folder_that_cannot_be_made_is_an_input_error(server: FileServer, tmp_path: Path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match=server.url):
        download(server.url, tmp_path / "file" / "model.safetensors")


def test_a_home_that_nobody_may_look_into_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(self: Path, **options: object) -> object:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "root"))
    monkeypatch.setattr(Path, "is_dir", refused)  # what Python raises for a user without rights; root has them
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    assert cache_home().parent == tmp_path
