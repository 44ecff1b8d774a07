"""The function that engines map: all files of a photo and its line, or a line that says why not."""

import errno
import os
from pathlib import Path, PurePosixPath

import pytest
from tests.jobs.photos import REQUEST, Brightness, contents, write_photo
from tests.test_batch import fail_with

from zoedepth.batch import predict_photo
from zoedepth.depth_map import DepthMap
from zoedepth.jobs.destinations import LocalFolder
from zoedepth.jobs.origins import Held
from zoedepth.jobs.work import Done, Input, do_photo
from zoedepth.outputs import sidecar
from zoedepth.photos import Photo


def photo_of(path: Path) -> Input:
    return Input(str(path), PurePosixPath(path.name), PurePosixPath("sub", path.stem), path)


def do(photo: Input, out: Path, predictor: Brightness | None = None) -> Done:
    return do_photo(photo, predictor or Brightness(), REQUEST, LocalFolder(out, "m"))


def test_it_writes_what_predict_photo_writes(tmp_path: Path) -> None:
    path = write_photo(tmp_path / "a.png")
    done = do(photo_of(path), tmp_path / "out")
    predict_photo(Photo(path, tmp_path / "expected" / "sub" / "a"), Brightness(), REQUEST)
    found = contents(tmp_path / "out")
    assert found == contents(tmp_path / "expected")
    assert done.entry.status == "done"
    assert done.entry.outputs == {
        name: (file, os.path.getsize(tmp_path / "out" / file))
        for name, file in (("npy", "sub/a_depth.npy"), ("depth", "sub/a_depth.png"), ("sidecar", "sub/a.json"))
    }
    assert (done.entry.size, done.entry.version) == (path.stat().st_size, path.stat().st_mtime_ns)
    assert done.sidecar["source"] == done.name == str(path)


def test_a_photo_from_elsewhere_is_predicted_as_its_file_would_be(tmp_path: Path) -> None:
    path = write_photo(tmp_path / "a.png")
    held = Held("archive.tar::a.png", path.read_bytes())
    photo = Input(held.name, PurePosixPath("a.png"), PurePosixPath("sub/a"), Path("a.png"), held, 99, 7)
    done = do(photo, tmp_path / "out")
    do(photo_of(path), tmp_path / "expected")
    assert (done.name, done.sidecar["source"]) == (held.name, held.name)
    assert (done.entry.size, done.entry.version) == (99, 7)
    found, expected = contents(tmp_path / "out"), contents(tmp_path / "expected")
    assert found["sub/a_depth.npy"] == expected["sub/a_depth.npy"]
    again = do(photo, tmp_path / "out")
    assert again.entry.status == "done"
    other = Input("b", photo.place, photo.target, photo.path, Held("other.tar::b.png", held.content))
    assert "of archive.tar::a.png, another photo" in str(do(other, tmp_path / "out").entry.error)


@pytest.mark.parametrize("content", [b"", b"no picture", None])
def test_a_photo_that_cannot_be_read_is_a_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "a.png"
    if content is not None:
        path.write_bytes(content)
    done = do(photo_of(path), tmp_path / "out")
    assert (done.entry.status, done.entry.outputs, done.end) == ("failed", {}, None)
    assert str(path) in str(done.entry.error)
    assert contents(tmp_path / "out") == {}


def test_a_photo_that_grows_while_it_is_read_fails(tmp_path: Path) -> None:
    path = write_photo(tmp_path / "a.png")

    class Growing(Brightness):
        def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
            with path.open("ab") as file:
                file.write(b"more")
            return super().__call__(image, domain=domain)

    assert "still being written" in str(do(photo_of(path), tmp_path / "out", Growing()).entry.error)
    assert contents(tmp_path / "out") == {}
    assert do(photo_of(path), tmp_path / "out").entry.status == "done"


@pytest.mark.parametrize(("number", "ends"), [(errno.ENOSPC, True), (errno.EFBIG, False)])
def test_a_full_disk_is_the_end_and_one_bad_file_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, ends: bool
) -> None:
    monkeypatch.setattr(sidecar, "write_sidecar", fail_with(number))
    done = do(photo_of(write_photo(tmp_path / "a.png")), tmp_path / "out")
    assert done.entry.status == "failed"
    assert (done.end is not None) == ends
    assert contents(tmp_path / "out") == {}


def test_a_bug_of_one_photo_is_its_line(tmp_path: Path) -> None:
    class OutOfMemory(Brightness):
        def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
            raise RuntimeError("out of memory")

    done = do(photo_of(write_photo(tmp_path / "a.png")), tmp_path / "out", OutOfMemory())
    assert done.entry.error == "RuntimeError: out of memory"
