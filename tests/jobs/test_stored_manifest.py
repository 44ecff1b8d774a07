"""A manifest in parts: a store gets whole ones, and a command that goes on reads them all."""

import errno

import fsspec
import pytest
from tests.test_batch import fail_with

from zoedepth.errors import InputError
from zoedepth.jobs import origins, stored_manifest
from zoedepth.jobs.manifest import Entry
from zoedepth.jobs.run import writing
from zoedepth.jobs.store import Store
from zoedepth.jobs.stored_manifest import StoredManifest, stored_parts

NAME = "zoedepth-manifest.jsonl"
ENTRIES = [
    Entry(f"s3://photos/{index}.jpg", "done", index, "etag", {"sidecar": (f"{index}.json", 1)}) for index in range(5)
]


@pytest.fixture
def store() -> Store:
    fsspec.filesystem("memory").store.clear()
    return Store("memory://bucket/out")


def add(store: Store, *entries: Entry) -> StoredManifest:
    manifest = StoredManifest(store, NAME)
    manifest.begin({"weights": "1"}, named=False)
    for entry in entries:
        manifest.add(entry)
    return manifest


def test_the_next_command_knows_what_was_done(store: Store) -> None:
    add(store, *ENTRIES[:2]).close()
    add(store, *ENTRIES[2:4]).close()
    manifest = add(store)
    assert [manifest.find(entry.input) for entry in ENTRIES] == [*ENTRIES[:4], None]
    assert len(manifest.runs) == 3
    manifest.close()
    # The third had nothing but its first line.
    assert [number for number, _ in stored_parts(store, "zoedepth-manifest")] == [0, 1, 2, 3, 4]


def test_a_kill_loses_the_last_seconds(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_manifest, "EVERY", 0)
    add(store, *ENTRIES[:3])  # never closed
    monkeypatch.setattr(stored_manifest, "EVERY", 1e9)
    add(store, *ENTRIES[3:])
    manifest = add(store)
    assert [manifest.find(entry.input) for entry in ENTRIES] == [*ENTRIES[:3], None, None]
    manifest.close()


def test_other_settings_are_refused(store: Store) -> None:
    add(store, *ENTRIES).close()
    manifest = StoredManifest(store, NAME)
    with pytest.raises(InputError, match="other settings"):
        manifest.begin({"weights": "2"}, named=False)
    manifest.close()


class TestTwoCommands:
    def test_the_one_that_began_last_goes_on_and_the_other_is_told(self, store: Store) -> None:
        first = add(store, ENTRIES[0])
        first.flush()
        second = add(store, ENTRIES[1])
        first.add(ENTRIES[2])
        with (
            pytest.raises(InputError, match=r"memory://bucket/out/zoedepth-manifest .* begun on it since: process \d+"),
            writing(first),
        ):
            first.flush()
        first.close()
        second.close()
        third = add(store)
        assert [third.find(entry.input) for entry in ENTRIES[:3]] == [*ENTRIES[:2], None]
        third.close()

    def test_at_the_same_moment(self, store: Store) -> None:
        manifests = [StoredManifest(store, NAME) for _ in range(2)]
        manifests[0].begin({}, named=False)
        with pytest.raises(FileExistsError, match="another command"):
            manifests[1].begin({}, named=False)
        for manifest in manifests:
            manifest.close()
        assert len(list(stored_parts(store, "zoedepth-manifest"))) == 1

    def test_a_part_whose_answer_was_lost_is_no_other_command_s(
        self, store: Store, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        system = type(fsspec.filesystem("memory"))
        put = system.put_file

        def unanswered(self: object, *arguments: object, **options: object) -> None:
            put(self, *arguments, **options)
            raise TimeoutError("no answer")

        monkeypatch.setattr(origins, "_FIRST_WAIT", 0)
        monkeypatch.setattr(system, "put_file", unanswered)
        add(store, *ENTRIES).close()
        assert len(list(stored_parts(store, "zoedepth-manifest"))) == 2


def test_a_store_that_is_gone_at_the_end_costs_lines_alone(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = add(store, *ENTRIES)
    monkeypatch.setattr(Store, "put", fail_with(errno.EIO))
    with pytest.raises(OSError, match="Input/output"):
        manifest.flush()
    manifest.close()
    monkeypatch.undo()
    manifest = add(store)
    assert manifest.find(ENTRIES[0].input) is None
    manifest.close()
