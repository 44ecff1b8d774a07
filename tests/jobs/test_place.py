"""The place of a job: a folder with a manifest and its lock, a store, or a stream's, which keeps none."""

import errno
from pathlib import Path

import pytest
from fsspec.implementations.memory import MemoryFileSystem

from zoedepth.errors import InputError
from zoedepth.jobs.destinations import LocalFolder
from zoedepth.jobs.place import job_place
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.store import Store


def test_a_folder_is_made_and_has_a_manifest_for_each_shard(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    for shard, name in ((JobShard(), "zoedepth-manifest"), (JobShard(0, 2), "zoedepth-manifest-0-of-2")):
        place = job_place(str(out), shard)
        assert place.destination == LocalFolder(out, name)
        with place.opened() as manifest:
            manifest.begin({}, named=False)
        assert (out / f"{name}.jsonl").is_file()
    assert {file.name for file in out.iterdir()} == {
        f"{name}.jsonl{lock}" for name in ("zoedepth-manifest", "zoedepth-manifest-0-of-2") for lock in ("", ".lock")
    }


def test_a_stream_keeps_none(tmp_path: Path) -> None:
    with job_place(tmp_path / "out", JobShard(), kept=False).opened() as manifest:
        manifest.begin({}, named=True)
    assert list(tmp_path.iterdir()) == []


def test_a_store_that_has_something_is_looked_at_before_it_is_written_to() -> None:
    fresh = job_place("memory://place/out/", JobShard()).destination
    assert fresh == Store("memory://place/out", fresh=True)
    with job_place("memory://place/out", JobShard()).opened() as manifest:
        manifest.begin({}, named=False)
    assert job_place("memory://place/out", JobShard()).destination == Store("memory://place/out", fresh=False)


def test_a_store_that_cannot_be_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(MemoryFileSystem, "exists", forbidden)
    with pytest.raises(InputError, match=r"--out memory://a/out cannot be looked at \(Permission denied\)"):
        job_place("memory://a/out", JobShard())


@pytest.mark.parametrize(("out", "message"), [("https://a.org/out", "nothing can be written"), ("xyz://a", "xyz")])
def test_where_nothing_can_be_written(out: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        job_place(out, JobShard())


def test_a_file_in_its_way(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be used"), job_place(tmp_path / "file", JobShard()).opened():
        pass
