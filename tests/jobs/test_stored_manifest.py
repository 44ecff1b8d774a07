"""A manifest in parts: a store gets whole ones, and a command that goes on reads them all."""

import fsspec
import pytest

from zoedepth.errors import InputError
from zoedepth.jobs import stored_manifest
from zoedepth.jobs.destinations import Store
from zoedepth.jobs.manifest import Entry
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
    assert len(stored_parts(store, "zoedepth-manifest")) == 5  # the third had nothing but its first line


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
