"""A set of names on disk: what was added is known, and the memory does not tell how much that was."""

import sqlite3

import pytest

from zoedepth.jobs.names import Names, key_of, row_key, temporary_database
from zoedepth.photos import NamesInMemory


def test_each_name_is_new_once() -> None:
    names = Names()
    assert [names.add(name) for name in ("a", "b", "a", "\udce9.jpg", "\udce9.jpg", "A")] == [
        True, True, False, True, False, True,
    ]  # fmt: skip
    names.close()


@pytest.mark.parametrize("kind", [Names, NamesInMemory])
def test_names_are_added_together_or_not_at_all(kind: type[Names] | type[NamesInMemory]) -> None:
    names = kind()
    assert names.add("day/c")
    assert names.add_all(["day/a", "day/b", "a"])
    for refused in (["day/d", "day/b"], ["day/d", "day/c"], ["day/d", "day/d"]):
        assert not names.add_all(refused)
    assert names.add_all([])
    assert [names.add(name) for name in ("day/a", "day/b", "day/c", "day/d", "a", "b")] == [
        False, False, False, True, False, True,
    ]  # fmt: skip


def test_a_full_disk_is_told_as_one() -> None:
    database = temporary_database()
    database.execute("CREATE TABLE t (x BLOB)")
    database.execute("PRAGMA max_page_count = 2")
    with pytest.raises(OSError, match="the disk for temporary files is full: make room, or name another by TMPDIR"):
        database.executemany("INSERT INTO t VALUES (?)", [(bytes(4000),)] * 20)
    with pytest.raises(sqlite3.OperationalError, match="no such table"):
        database.execute("SELECT * FROM u")


def test_rows_of_a_folder_lie_side_by_side() -> None:
    assert row_key("/in/day 1/a.jpg")[:4] == row_key("/in/day 1/b.jpg")[:4] != row_key("/in/day 2/a.jpg")[:4]
    assert row_key("C:\\in\\a.jpg")[:4] == row_key("C:\\in\\b.jpg")[:4]
    assert row_key("/in/day 1/a.jpg")[4:] == key_of("/in/day 1/a.jpg")


def test_keys_are_the_same_on_every_machine() -> None:
    assert key_of("photos/a.jpg").hex() == "eea2c680d629b11d02e48cf37b1213a4"
