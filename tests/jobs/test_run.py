"""A job in this process: typed again, it does what is missing, failed or changed, and nothing twice."""

import errno
import multiprocessing
import os
import random
import shutil
import sys
import tarfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from tests.jobs.photos import REQUEST, Brightness, contents, entries, run, write_photo, write_photos
from tests.servers import PATIENCE
from tests.test_batch import fail_with

from zoedepth import batch, photos
from zoedepth.batch import Request
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.jobs import run as run_module
from zoedepth.jobs.manifest import Manifest
from zoedepth.jobs.run import Tally, count_in_background
from zoedepth.outputs import sidecar

MANIFEST = "zoedepth-manifest.jsonl"


class Counting(Brightness):
    """Counts how often each photo is predicted."""

    def __init__(self) -> None:
        super().__init__()
        self.seen = Counter[str]()
        self.lock = threading.Lock()

    def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
        with self.lock:
            self.seen[Path(str(image)).name] += 1
        return super().__call__(image, domain=domain)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_photos(tmp_path / "in")


def test_a_second_time_nothing_is_done(folder: Path, tmp_path: Path) -> None:
    predictor = Counting()
    results, tally = run(folder, out=tmp_path / "out", predictor=predictor, workers=2)
    assert (tally.done, tally.before, len(results)) == (4, 0, 4)
    before = contents(tmp_path / "out")
    assert len(before) == 12
    results, tally = run(folder, out=tmp_path / "out", predictor=predictor)
    assert (tally.done, tally.before, results) == (0, 4, [])
    assert set(predictor.seen.values()) == {1}
    assert contents(tmp_path / "out") == before
    _, tally = run(folder, out=tmp_path / "out", predictor=predictor, overwrite=True)
    assert (tally.done, tally.before) == (4, 0)
    assert contents(tmp_path / "out") == before
    assert not [file for file in (tmp_path / "out").iterdir() if file.name.startswith(".zoedepth-drafts")]


# Linux keeps names as bytes, of any kind. macOS and Windows refuse to make a file of this name.
@pytest.mark.skipif(sys.platform != "linux", reason="Windows and macOS keep names as Unicode")
def test_a_second_time_nothing_is_done_for_names_that_are_not_utf8(tmp_path: Path) -> None:
    write_photo(tmp_path / "in" / os.fsdecode(b"caf\xe9.png"))
    assert run(tmp_path / "in", out=tmp_path / "out")[1].done == 1
    again = run(tmp_path / "in", out=tmp_path / "out")[1]
    assert (again.done, again.before) == (0, 1)


def test_new_failed_and_changed_photos_are_done_and_so_are_those_whose_files_are_gone(
    folder: Path, tmp_path: Path
) -> None:
    (folder / "bad.png").write_bytes(b"no picture")
    results, tally = run(folder, out=tmp_path / "out")
    assert (tally.done, tally.failed) == (4, 1)
    write_photo(folder / "new.png")
    write_photo(folder / "bad.png")
    write_photo(folder / "day 0" / "0.png", size=(9, 9), seed=7)  # changed
    (tmp_path / "out" / "day 0" / "2.json").unlink()  # gone; the array beside it does not say whose it is
    (tmp_path / "out" / "day 1" / "1.json").write_text((tmp_path / "out" / "day 1" / "1.json").read_text() + " ")
    results, tally = run(folder, out=tmp_path / "out")
    assert {Path(done.name).name for done in results} == {"new.png", "bad.png", "0.png", "2.png", "1.png"}
    assert (tally.done, tally.failed, tally.before) == (5, 0, 1)
    run(folder, out=tmp_path / "again")
    assert contents(tmp_path / "out") == contents(tmp_path / "again")


def test_photos_of_an_earlier_command_are_not_opened_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(folder, out=tmp_path / "out")
    looked_at = []
    monkeypatch.setattr(photos, "is_own_file", lambda file: looked_at.append(file.name))
    write_photo(folder / "day 1" / "new.png")
    _, tally = run(folder, out=tmp_path / "out", known=True)
    assert (looked_at, tally.done, tally.before) == (["new.png"], 1, 4)


def test_a_depth_map_in_the_place_of_a_photo_is_no_photo(folder: Path, tmp_path: Path) -> None:
    request = Request("brightness", ("depth",))
    run(folder, out=tmp_path / "out", request=request)
    shutil.copy(tmp_path / "out" / "day 0" / "0_depth.png", folder / "day 0" / "0.png")
    results, tally = run(folder, out=tmp_path / "out", known=True, request=request)
    assert (tally.done, tally.failed, tally.before, results) == (0, 0, 3, [])


def test_interrupted_at_any_photo_it_goes_on(folder: Path, tmp_path: Path) -> None:
    run(folder, out=tmp_path / "expected")
    predictor = Counting()

    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(folder, out=tmp_path / "out", predictor=predictor, at=interrupt)
    for _ in range(3):
        with suppress(KeyboardInterrupt):  # one more may have begun each time
            run(folder, out=tmp_path / "out", predictor=predictor, at=interrupt)
    _, tally = run(folder, out=tmp_path / "out", predictor=predictor)
    assert tally.seen == 4
    assert set(predictor.seen.values()) == {1}
    assert contents(tmp_path / "out") == contents(tmp_path / "expected")
    done = entries(tmp_path / "out" / MANIFEST)
    assert len(done) == len({entry.input for entry in done}) == 4


def test_a_manifest_without_its_end_costs_a_photo_and_not_its_truth(folder: Path, tmp_path: Path) -> None:
    """Each kind of file of the photo that was in hand is there or not; none is half."""
    run(folder, out=tmp_path / "out")
    expected = contents(tmp_path / "out")
    path = tmp_path / "out" / MANIFEST
    path.write_bytes(path.read_bytes()[:-40])
    _, tally = run(folder, out=tmp_path / "out")
    assert (tally.done, tally.before) == (1, 3)
    assert contents(tmp_path / "out") == expected


def test_killed_at_any_moment_it_gives_each_photo_once(tmp_path: Path) -> None:
    """``python -m benchmarks.jobs kill`` does so with the whole command, 50 times."""
    folder, out, rng = write_photos(tmp_path / "in", 12), tmp_path / "out", random.Random(0)
    run(folder, out=tmp_path / "expected")
    # To start anew, as Windows must, takes longer than the job that is to be killed.
    context = multiprocessing.get_context("fork" if hasattr(os, "fork") else "spawn")
    for _ in range(8):
        process = context.Process(target=run, args=(folder,), kwargs={"out": out})
        process.start()
        wanted = len(entries(out / MANIFEST)) + rng.randrange(3) if (out / MANIFEST).exists() else 1
        deadline = time.monotonic() + PATIENCE  # minutes: it ends a job that hangs, and is met by no job that works
        while process.is_alive() and not ((out / MANIFEST).exists() and len(entries(out / MANIFEST)) >= wanted):
            assert time.monotonic() < deadline
            time.sleep(0.001)
        time.sleep(rng.random() * 0.01)
        process.kill()
        process.join()
    _, tally = run(folder, out=out)
    assert (tally.seen, tally.failed) == (12, 0)
    assert contents(out) == contents(tmp_path / "expected")
    done = Counter(entry.input for entry in entries(out / MANIFEST))
    assert set(done.values()) == {1}
    assert len(done) == 12


def test_drafts_of_a_killed_command_are_finished_or_taken_away(folder: Path, tmp_path: Path) -> None:
    """A kill between the renaming of an array, which does not say whose it is, and of its sidecar, which does."""
    real, left = Path.replace, 1

    class Killed(BaseException):
        pass

    def replace(self: Path, target: Path) -> Path:
        nonlocal left
        if ".zoedepth-drafts" in str(self) and ".zoedepth-drafts" not in str(target):
            left -= 1
            if left < 0:
                raise Killed
        return real(self, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        patch.setattr("shutil.rmtree", lambda *_, **__: None)  # whoever is killed tidies nothing
        patch.setattr("zoedepth.jobs.destinations.LocalFolder.tidy", lambda self: None)
        with pytest.raises(Killed):
            run(folder, out=tmp_path / "out")
    assert set(contents(tmp_path / "out")) & {"day 0/0_depth.npy", "day 0/0.json"} == {"day 0/0_depth.npy"}
    _, tally = run(folder, out=tmp_path / "out")
    assert (tally.done, tally.failed) == (4, 0)
    run(folder, out=tmp_path / "expected")
    assert contents(tmp_path / "out") == contents(tmp_path / "expected")


def test_shards_share_the_work(folder: Path, tmp_path: Path) -> None:
    for index in range(4, 20):
        write_photo(folder / f"{index}.png", seed=index)
    predictor = Counting()
    numbers = [run(folder, out=tmp_path / "out", shard=f"{i}/3", predictor=predictor)[1].done for i in range(3)]
    assert sum(numbers) == 20
    assert all(numbers)
    assert set(predictor.seen.values()) == {1}
    run(folder, out=tmp_path / "expected")
    assert contents(tmp_path / "out") == contents(tmp_path / "expected")
    assert (
        len(
            {entry.input for i in range(3) for entry in entries(tmp_path / "out" / f"zoedepth-manifest-{i}-of-3.jsonl")}
        )
        == 20
    )


def test_other_settings_of_a_folder_are_refused_and_of_a_photo_taken(folder: Path, tmp_path: Path) -> None:
    other = {"weights": "2"}
    run(folder, out=tmp_path / "out")
    with pytest.raises(InputError, match='weights was "1" and is now "2"'):
        run(folder, out=tmp_path / "out", settings=other)
    photo = folder / "day 0" / "0.png"
    assert run(photo, out=tmp_path / "photo")[1].done == 1
    assert run(photo, out=tmp_path / "photo")[1].before == 1
    assert run(photo, out=tmp_path / "photo", settings=other)[1].done == 1
    assert run(photo, out=tmp_path / "photo", settings=other)[1].before == 1
    assert run(folder, out=tmp_path / "out", settings=other, overwrite=True)[1].done == 4
    assert run(folder, out=tmp_path / "out", settings=other)[1].before == 4


def test_of_compressed_archives_a_few_members_wait_unpacked(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = tmp_path / "photos.tar.gz"
    with tarfile.open(packed, "w:gz") as archive:
        archive.add(folder, "photos")
    monkeypatch.setattr(batch, "MAX_HELD", 1)
    waiting: list[int] = []
    original = run_module._held
    monkeypatch.setattr(run_module, "_held", lambda item: waiting.append(original(item)) or original(item))
    _, tally = run(packed, out=tmp_path / "out")
    assert tally.done == 4
    assert len(waiting) == 4
    assert min(waiting) > 1


def test_two_commands_on_one_folder(folder: Path, tmp_path: Path) -> None:
    def again(_: object) -> None:
        with pytest.raises(InputError, match="another command works on"):
            run(folder, out=tmp_path / "out")

    run(folder, out=tmp_path / "out", at=again)
    assert len(entries(tmp_path / "out" / MANIFEST)) == 4


@pytest.mark.parametrize("where", ["output", "manifest"])
def test_a_full_disk_is_the_end_and_it_goes_on_when_there_is_room(
    folder: Path, tmp_path: Path, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if where == "output":
        monkeypatch.setattr(sidecar, "write_sidecar", fail_with(errno.ENOSPC))
    else:
        monkeypatch.setattr(Manifest, "add", fail_with(errno.ENOSPC))
    with pytest.raises(InputError, match="No space left"):
        run(folder, out=tmp_path / "out")
    monkeypatch.undo()
    assert entries(tmp_path / "out" / MANIFEST) == []
    _, tally = run(folder, out=tmp_path / "out", request=REQUEST)
    assert (tally.done, tally.failed) == (4, 0)


def test_a_disk_that_is_gone_is_the_end_and_it_goes_on_when_it_is_back(folder: Path, tmp_path: Path) -> None:
    out, away = tmp_path / "out", tmp_path / "away"

    class TakesAway(Brightness):
        """Takes the folder away at the third photo, in the thread that writes the files."""

        def __call__(self, image: object, *, domain: str | None = None) -> DepthMap:
            if entries(out / MANIFEST)[1:]:
                out.rename(away)
                out.touch()  # nothing can be written below a file, whatever rights one has
            return super().__call__(image, domain=domain)

    with pytest.raises(InputError, match="cannot write to"):
        run(folder, out=out, predictor=TakesAway())
    out.unlink()
    away.rename(out)
    _, tally = run(folder, out=out)
    assert (tally.seen, tally.failed) == (4, 0)
    assert tally.before > 0
    run(folder, out=tmp_path / "expected")
    assert contents(out) == contents(tmp_path / "expected")


def test_a_folder_that_cannot_be_listed_is_told_and_the_rest_is_done(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scandir = os.scandir

    def refuse(path: str) -> object:
        if isinstance(path, str) and Path(path).name == "day 1":
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    results, tally = run(folder, out=tmp_path / "out")
    assert (tally.done, [done.entry.error for done in results]) == (2, [None, None])


def test_inputs_are_counted_in_the_background() -> None:
    tally = Tally()
    count_in_background(tally, lambda: iter("abc")).join()
    assert tally.total == 3

    def broken() -> object:
        raise InputError("no")

    tally = Tally()
    count_in_background(tally, broken).join()
    assert tally.total is None


def test_a_request_without_files_of_its_own_is_a_job_too(folder: Path, tmp_path: Path) -> None:
    assert run(folder, out=tmp_path / "out", request=Request("b", ()))[1].done == 4
    assert {Path(name).suffix for name in contents(tmp_path / "out")} == {".json"}


def test_photos_of_one_name_typed_in_two_folders_do_not_replace_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    for seed, folder in enumerate(("one", "two")):
        write_photo(tmp_path / folder / "a.png", size=(5, 8), seed=seed)
    monkeypatch.chdir(tmp_path / "one")
    assert run("a.png", out=out)[1].done == 1
    before = contents(out)
    monkeypatch.chdir(tmp_path / "two")
    results, tally = run("a.png", out=out)
    assert (tally.done, tally.failed) == (0, 1)
    assert f"a.json is of {tmp_path / 'one' / 'a.png'}, another photo" in str(results[0].entry.error)
    assert contents(out) == before
    assert run("a.png", out=out, shard="0/1", overwrite=True)[1].failed == 1, "also where all is to be done again"
    shutil.copyfile(tmp_path / "one" / "a.png", "a.png")
    assert run("a.png", out=out)[1].done == 1, "a copy is the same photo"


def test_a_photo_that_was_moved_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_photo(tmp_path / "one" / "a.png", size=(5, 8), seed=1)
    monkeypatch.chdir(tmp_path / "one")
    assert run("a.png", out=tmp_path / "out")[1].done == 1
    (tmp_path / "one").rename(tmp_path / "two")
    monkeypatch.chdir(tmp_path / "two")
    assert run("a.png", out=tmp_path / "out")[1].done == 1
    write_photo(tmp_path / "one" / "a.png", size=(5, 8), seed=2)  # another one in the old place
    monkeypatch.chdir(tmp_path / "one")
    assert run("a.png", out=tmp_path / "out")[1].failed == 1, "the files are of two/a.png by now"
