"""A job as a whole: its shards add up, and one manifest of theirs goes on where they were."""

import errno
from pathlib import Path

import fsspec
import pytest
from tests.jobs.photos import contents, entries, run, write_photo, write_photos

from zoedepth.errors import InputError
from zoedepth.jobs.report import merge_shards, missing_shards, read_failures, read_status
from zoedepth.jobs.shard import JobShard


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A job of ten photos in three shards, of which two are done; one photo is broken."""
    folder = write_photos(tmp_path / "in", 9)
    (folder / "bad.png").write_bytes(b"no picture")
    for shard in ("0/3", "2/3"):
        run(folder, out=tmp_path / "out", shard=shard)
    return tmp_path / "out"


def test_status_adds_up(job: Path) -> None:
    found = read_status(str(job))
    assert [str(each.shard) for each in found] == ["0/3", "2/3"]
    assert missing_shards(found) == [JobShard(1, 3)]
    run(job.parent / "in", out=job, shard="1/3")
    found = read_status(str(job))
    assert missing_shards(found) == []
    assert (sum(each.done for each in found), sum(each.failed for each in found)) == (9, 1)
    (failure,) = read_failures(str(job))
    assert failure.input == str(job.parent / "in" / "bad.png")
    assert "not an image" in str(failure.error)
    assert not any(each.running for each in found)


def test_a_shard_that_is_worked_on_is_running(job: Path) -> None:
    seen = []
    run(job.parent / "in", out=job, shard="1/3", at=lambda _: seen.append([e.running for e in read_status(str(job))]))
    assert seen[0] == [False, True, False]


def test_more_shards_are_merged_than_files_may_be_open_as_a_rule(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource", reason="this system has no limit of open files")
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, 4096))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: asked.append(limits))
    merge_shards(str(job))
    ((now, most),) = asked
    assert 64 < now <= most == 4096


def test_merged_it_goes_on_without_shards(job: Path) -> None:
    before = contents(job)
    n_done = sum(each.done for each in read_status(str(job)))
    assert merge_shards(str(job)) == n_done
    assert {file.name for file in job.iterdir() if "manifest" in file.name} == {
        "zoedepth-manifest.jsonl", "zoedepth-manifest.jsonl.lock",
    }  # fmt: skip
    write_photo(job.parent / "in" / "bad.png")
    _, tally = run(job.parent / "in", out=job)
    assert (tally.before, tally.done, tally.failed) == (n_done, 10 - n_done, 0)
    assert contents(job).items() >= before.items()
    assert len({entry.input for entry in entries(job / "zoedepth-manifest.jsonl") if entry.status == "done"}) == 10
    with pytest.raises(InputError, match="no shards to merge"):
        merge_shards(str(job))


def test_merged_it_goes_on_with_other_shards(job: Path) -> None:
    n_done = merge_shards(str(job))
    tallies = [run(job.parent / "in", out=job, shard=f"{i}/2")[1] for i in range(2)]
    assert sum(tally.before for tally in tallies) == n_done
    assert sum(tally.done for tally in tallies) == 9 - n_done
    assert merge_shards(str(job)) == 9


def test_a_named_photo_of_other_settings_changes_nothing_of_the_job(job: Path) -> None:
    run(job.parent / "in", out=job, shard="1/3")
    before = [entry.input for entry in read_failures(str(job))]
    assert len(before) == 1
    photo = write_photo(job.parent / "x" / "new.png")
    for shard in range(3):
        run(photo, out=job, shard=f"{shard}/3", settings={"weights": "2"})
    found = read_status(str(job))
    assert (sum(each.done for each in found), sum(each.failed for each in found)) == (9, 1)
    assert len({each.fingerprint for each in found}) == 1
    assert [entry.input for entry in read_failures(str(job))] == before
    assert merge_shards(str(job)) == 9


def test_shards_of_named_photos_are_merged(tmp_path: Path) -> None:
    """So a shell hands over photos/*.png. A photo that was tried before with other settings is none of the job."""
    photos = sorted(write_photos(tmp_path / "in", 6).rglob("*.png"))
    run(photos[1], out=tmp_path / "out", settings={"weights": "2"})
    run(photos[0], out=tmp_path / "out")
    for shard in ("0/2", "1/2"):
        run(*photos, out=tmp_path / "out", shard=shard)
    assert merge_shards(str(tmp_path / "out")) == 6


@pytest.mark.parametrize("error", [PermissionError(errno.EACCES, "Permission denied"), OSError(errno.EIO, "I/O error")])
def test_a_lock_that_cannot_be_asked_says_nothing(job: Path, error: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("filelock.FileLock.acquire", refuse)
    assert [each.running for each in read_status(str(job))] == [None, None]


def test_what_is_in_the_whole_already_stays(job: Path) -> None:
    run(job.parent / "in", out=job)
    assert merge_shards(str(job)) == 9
    assert run(job.parent / "in", out=job)[1].before == 9


def test_shards_of_different_settings_are_refused_and_kept(job: Path) -> None:
    run(job.parent / "in", out=job, shard="1/3", settings={"weights": "2"})
    with pytest.raises(InputError, match="different settings"):
        merge_shards(str(job))
    assert len(list(job.glob("zoedepth-manifest-*.jsonl"))) == 3


def test_a_running_shard_is_not_merged(job: Path) -> None:
    def merge(_: object) -> None:
        with pytest.raises(InputError, match="another command works on"):
            merge_shards(str(job))

    run(job.parent / "in", out=job, shard="1/3", at=merge)


def test_what_is_no_job(tmp_path: Path) -> None:
    for out in (tmp_path, tmp_path / "none", "memory://none/at/all"):
        with pytest.raises(InputError, match=r"job|nothing at"):
            read_status(str(out))


def test_a_stores_manifest_that_was_copied_is_none_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "zoedepth-manifest-0-of-2").mkdir()
    with pytest.raises(InputError, match="is not the --out of a job"):
        read_status(str(tmp_path))


def test_a_job_in_a_store(tmp_path: Path) -> None:
    fsspec.filesystem("memory").store.clear()
    folder = write_photos(tmp_path / "in")
    for shard in ("0/2", "1/2"):
        run(folder, out="memory://bucket/out", shard=shard)
    found = read_status("memory://bucket/out")
    assert [(str(each.shard), each.running) for each in found] == [("0/2", None), ("1/2", None)]
    assert sum(each.done for each in found) == 4
    with pytest.raises(InputError, match="merged in folders, and not in stores"):
        merge_shards("memory://bucket/out")
