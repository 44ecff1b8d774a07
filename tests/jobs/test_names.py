"""A set of names on disk: what was added is known, and the memory does not tell how much that was."""

from zoedepth.jobs.names import Names, key_of


def test_each_name_is_new_once() -> None:
    names = Names()
    assert [names.add(name) for name in ("a", "b", "a", "\udce9.jpg", "\udce9.jpg", "A")] == [
        True, True, False, True, False, True,
    ]  # fmt: skip
    names.close()


def test_keys_are_the_same_on_every_machine() -> None:
    assert key_of("photos/a.jpg").hex() == "eea2c680d629b11d02e48cf37b1213a4"
