"""Small texts and JSON are read as written, and refused where they are too long, too deep, or something else."""

import os
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.stored import MAX_NESTING, parse_json, read_json, read_numbers, read_text, readable, to_json, unreadable


def test_numbers(tmp_path: Path) -> None:
    (tmp_path / "camera.txt").write_text("1, 2.5\n-3e2\t4")
    assert read_numbers(tmp_path / "camera.txt") == [1, 2.5, -300, 4]
    (tmp_path / "camera.txt").write_text("1 two")
    with pytest.raises(InputError, match=r"camera\.txt is not a text file of numbers.*two"):
        read_numbers(tmp_path / "camera.txt")


def test_byte_order_mark_is_no_part_of_a_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes("500 510 320 240".encode("utf-8-sig"))  # as Notepad writes it
    assert read_text(tmp_path / "a.txt") == "500 510 320 240"
    assert read_numbers(tmp_path / "a.txt") == [500, 510, 320, 240]
    (tmp_path / "a.json").write_bytes('{"fx": 500}'.encode("utf-8-sig"))
    assert read_json(tmp_path / "a.json") == {"fx": 500}


def test_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("käse", encoding="utf-8")
    assert read_text(tmp_path / "a.txt", max_bytes=5) == "käse"
    for content, word in ((b"k\xc3\xa4ses", "longer than 5 bytes"), (b"\xff", "UTF-8")):
        (tmp_path / "a.txt").write_bytes(content)
        with pytest.raises(InputError, match=rf"a\.txt.*{word}"):
            read_text(tmp_path / "a.txt", max_bytes=5)
    with pytest.raises(InputError, match=r"cannot read .*b\.txt"):
        read_text(tmp_path / "b.txt")


def test_object(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(
        b'\xef\xbb\xbf{"a": [1, -2.5e3, true, null, "NaN"]}'
    )  # with a mark, as editors write
    assert read_json(tmp_path / "a.json") == {"a": [1, -2500, True, None, "NaN"]}


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", "null", '{"a": NaN}', '{"a": [-Infinity]}', '{"a": 1e39}', '{"a": 1e999}',
     '{"a": 1' + "0" * 50 + "}", "[" * 100_000, '{"a":' * MAX_NESTING + "1" + "}" * MAX_NESTING, b"\xff\xfe\xfd"],
    ids=lambda text: str(text)[:20],
)  # fmt: skip
def test_anything_else_is_an_error_that_says_where(text: str | bytes) -> None:
    with pytest.raises(InputError, match=r"^the file: not a JSON object"):
        parse_json(text, "the file")


def test_brackets_as_deep_as_allowed() -> None:
    levels = MAX_NESTING - 1
    assert parse_json('{"a":' * levels + "1" + "}" * levels, "the file")


def test_length(tmp_path: Path) -> None:
    assert parse_json('{"a": 1}', "the file", max_bytes=8) == {"a": 1}
    with pytest.raises(InputError, match="the file: longer than 7 bytes"):
        parse_json('{"a": 1}', "the file", max_bytes=7)
    with (tmp_path / "a.json").open("wb") as file:
        file.truncate(10**12)  # takes no room on the disk
    with pytest.raises(InputError, match=r"a\.json is longer than 1,048,576 bytes"):
        read_json(tmp_path / "a.json")


def test_names_of_files_can_be_written_whatever_their_bytes_are() -> None:
    """Bytes as Python gives them: of UTF-8 under an ASCII locale, and of Latin-1 under any."""
    for name, written in (
        (b"k\xc3\xa4se.jpg".decode("ascii", "surrogateescape"), "käse.jpg"),
        (b"k\xe4se.jpg".decode("utf-8", "surrogateescape"), "k\\xe4se.jpg"),
        ("客厅.jpg", "客厅.jpg"),
    ):
        assert readable(name) == written
        assert os.fsencode(unreadable(written)) == os.fsencode(name)
        text = to_json({name: [(name, None)], "number": 1.5})
        assert text.isascii()
        assert parse_json(text, "text") == {written: [[written, None]], "number": 1.5}
    with pytest.raises(ValueError, match="JSON"):
        to_json([float("nan")])
