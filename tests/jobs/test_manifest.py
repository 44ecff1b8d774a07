"""The manifest: it tells the truth, whatever byte the command that wrote it was killed at."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from tests.jobs.photos import entries

from zoedepth.errors import InputError
from zoedepth.jobs.manifest import Entry, Manifest, fingerprint_of, is_manifest, manifest_name, parse_line
from zoedepth.jobs.shard import JobShard

SETTINGS: dict[str, object] = {"weights": "abc", "flip": True}
A = Entry("/photos/a.jpg", "done", 100, 12345, {"depth": ("x/a_depth.png", 7), "sidecar": ("x/a.json", 9)}, 0.25)
B = Entry("s3://photos/b.jpg", "done", None, '"etag"', {"sidecar": ("b.json", 1)}, 1.0)
BROKEN = Entry("/photos/c.jpg", "failed", 0, 1, {}, 0.0, "is not an image")


def write(path: Path, *entries: Entry, settings: dict[str, object] = SETTINGS, **options: bool) -> None:
    manifest = Manifest(path)
    manifest.begin(settings, **{"named": False, **options})
    for entry in entries:
        manifest.add(entry)
    manifest.close()


def found(path: Path, *names: str, settings: dict[str, object] = SETTINGS, **options: bool) -> list[Entry | None]:
    manifest = Manifest(path)
    manifest.begin(settings, **{"named": False, **options})
    result = [manifest.find(name) for name in names]
    manifest.close()
    return result


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / "m.jsonl"


def test_what_was_added_is_found_by_the_next_command(path: Path) -> None:
    write(path, A, BROKEN, B)
    assert found(path, A.input, B.input, BROKEN.input, "/photos/d.jpg") == [A, B, None, None]
    manifest = Manifest(path)
    assert (manifest.n_done, manifest.n_failed) == (2, 1)
    assert (
        manifest.fingerprint == fingerprint_of(SETTINGS) == json.loads(path.read_text().splitlines()[0])["fingerprint"]
    )
    manifest.close()


@pytest.mark.parametrize("entry", [A, B, BROKEN, replace(A, input="caf\udce9.jpg")])
def test_a_line_is_read_as_it_was_written(entry: Entry) -> None:
    read = parse_line(entry.to_line())
    assert read == replace(entry, input=entry.input.replace("\udce9", "\\xe9"))


def test_names_that_are_no_text_are_found(path: Path) -> None:
    write(path, replace(A, input="caf\udce9.jpg"))
    assert found(path, "caf\udce9.jpg")[0] is not None


@pytest.mark.parametrize(
    "line",
    [b"", b"{}\n", b"[]\n", b"1\n", b"{\n", b'{"input": 1}\n', b"\xff\n", b"[" * 9999 + b"\n", A.to_line()[:-1],
     A.to_line().replace(b"7", b'"x"'), b'{"zoedepth_manifest": 1}\n'],
)  # fmt: skip
def test_other_lines_are_none(line: bytes) -> None:
    assert parse_line(line) is None


def test_cut_at_every_byte_it_tells_the_truth_and_goes_on(path: Path) -> None:
    write(path, A, BROKEN, B)
    whole = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == 10]
    assert len(ends) == 4
    for cut in range(len(whole) + 1):
        path.write_bytes(whole[:cut])
        manifest = Manifest(path)
        manifest.begin(SETTINGS, named=False)
        assert manifest.find(A.input) == (A if cut >= ends[1] else None), cut
        assert manifest.find(B.input) == (B if cut >= ends[3] else None), cut
        manifest.add(B)  # after half a line, it stands in a line of its own
        manifest.close()
        manifest = Manifest(path)
        manifest.begin(SETTINGS, named=False)
        assert manifest.find(B.input) == B, cut
        # A line that lacks nothing but its end gets that now.
        assert manifest.find(A.input) == (A if cut >= ends[1] - 1 else None), cut
        manifest.close()


def test_a_success_wins_over_a_later_failure_and_a_later_success_over_it(path: Path) -> None:
    write(path, A, replace(A, status="failed", outputs={}, error="busy"), replace(BROKEN, input=B.input), B)
    assert found(path, A.input, B.input) == [A, B]
    newer = replace(A, version=99999)
    # It has failed since the photo was replaced: the success was of another.
    write(path, replace(newer, status="failed", outputs={}, error="broken"))
    assert found(path, A.input) == [None]
    manifest = Manifest(path)
    assert (manifest.n_done, manifest.n_failed) == (1, 1)
    manifest.close()
    write(path, newer)
    assert found(path, A.input) == [newer]
    manifest = Manifest(path)
    assert (manifest.n_done, manifest.n_failed) == (2, 0)
    manifest.close()


OTHER: dict[str, object] = {**SETTINGS, "flip": False}


class TestOtherSettings:
    def test_of_a_job_are_refused_and_named(self, path: Path) -> None:
        write(path, A)
        before = path.read_bytes()
        with pytest.raises(InputError, match=r"other settings: flip was true and is now false.*--overwrite"):
            write(path, settings=OTHER)
        assert path.read_bytes() == before

    def test_overwrite_forgets_what_was_done(self, path: Path) -> None:
        write(path, A, B)
        assert found(path, A.input, settings=OTHER, overwrite=True) == [None]
        write(path, A, settings=OTHER)  # goes on
        assert found(path, A.input, B.input, settings=OTHER) == [A, None]
        with pytest.raises(InputError, match="flip was false and is now true"):
            write(path)

    def test_overwrite_with_the_same_settings_forgets_it_too(self, path: Path) -> None:
        write(path, A, B)
        write(path, B, overwrite=True)
        assert found(path, A.input, B.input) == [None, B]

    def test_of_photos_that_are_named_are_taken_and_the_job_goes_on(self, path: Path) -> None:
        write(path, A, B)
        assert found(path, A.input, named=True) == [A]
        assert found(path, A.input, settings=OTHER, named=True) == [None]
        write(path, A, settings=OTHER, named=True, overwrite=True)
        assert found(path, A.input, settings=OTHER, named=True) == [A]
        assert found(path, A.input, B.input) == [None, B]  # a folder gives all its photos by its own settings
        write(path, A)
        assert found(path, A.input, B.input) == [A, B]

    def test_those_of_the_last_job_count(self, path: Path) -> None:
        write(path, A, B, BROKEN)
        write(path, replace(B, size=5), settings=OTHER, named=True)  # a folder would do it again
        manifest = Manifest(path)
        assert (manifest.n_done, manifest.n_failed) == (1, 1)
        assert list(manifest.current()) == [A, BROKEN]
        manifest.close()

    def test_photos_that_are_named_all_count(self, path: Path) -> None:
        write(path, A, BROKEN, named=True)
        write(path, B, settings=OTHER, named=True)
        manifest = Manifest(path)
        assert (manifest.n_done, manifest.n_failed) == (2, 1)
        assert list(manifest.current()) == [A, BROKEN, B]
        assert list(manifest.current(fingerprint_of(OTHER))) == [B]
        manifest.close()


class TestWhole:
    def find(self, path: Path, settings: dict[str, object] = SETTINGS) -> list[Entry | None]:
        whole = Manifest(path)
        shard = Manifest(path.with_name("shard.jsonl"), whole=whole)
        shard.begin(settings, named=False)
        result = [shard.find(entry.input) for entry in (A, B, BROKEN)]
        shard.close()
        whole.close()
        return result

    def test_what_is_done_by_the_whole_job_is_done(self, path: Path) -> None:
        write(path, A, BROKEN)
        write(path.with_name("shard.jsonl"), B)
        assert self.find(path) == [A, B, None]

    def test_other_settings_are_others(self, path: Path) -> None:
        write(path, A)
        assert self.find(path, OTHER) == [None] * 3

    def test_overwrite_forgets_it(self, path: Path) -> None:
        write(path, A, B)
        write(path.with_name("shard.jsonl"), B, overwrite=True)  # killed before it came to A
        assert self.find(path) == [None, B, None]


def test_what_is_no_manifest_is_refused_and_kept(path: Path) -> None:
    path.parent.mkdir()
    path.write_text('{"audio": "a.wav"}\n')
    with pytest.raises(InputError, match="not a manifest of zoedepth: move it"):
        Manifest(path)
    assert not is_manifest(path)
    assert path.read_text() == '{"audio": "a.wav"}\n'


def test_a_disk_that_takes_a_part_of_a_line_is_an_error(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = Manifest(path)
    manifest.begin(SETTINGS, named=False)
    write_all = os.write
    monkeypatch.setattr(os, "write", lambda file, line: write_all(file, line[:20]))
    with pytest.raises(OSError, match="No space"):
        manifest.add(A)
    manifest.close()
    monkeypatch.undo()
    assert entries(path) == []
    write(path, B)
    assert entries(path) == [B]


def test_names() -> None:
    assert manifest_name(JobShard()) == "zoedepth-manifest.jsonl"
    assert manifest_name(JobShard(2, 8)) == "zoedepth-manifest-2-of-8.jsonl"


def test_it_knows_the_files_that_are_done_and_have_not_changed(path: Path, tmp_path: Path) -> None:
    photos = [tmp_path / f"{name}.jpg" for name in ("done", "failed", "changed", "gone", "new")]
    for photo in photos:
        photo.write_bytes(b"photo")
    states = [(photo, photo.stat().st_size, photo.stat().st_mtime_ns) for photo in photos[:4]]
    write(path, *(
        Entry(str(photo), "failed" if photo.stem == "failed" else "done", size, time) for photo, size, time in states
    ))  # fmt: skip
    photos[2].write_bytes(b"another photo")
    photos[3].unlink()
    manifest = Manifest(path)
    assert [manifest.knows(str(photo)) for photo in photos] == [True, False, False, False, False]
    manifest.begin({"weights": "other"}, named=True)
    assert manifest.knows(str(photos[0]))  # it was a photo under other settings, too
    manifest.close()
