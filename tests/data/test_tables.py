"""Tables as spreadsheets write them: separators, capitals, encodings, empty cells, and numbers of other countries."""

from pathlib import Path

import pytest

from zoedepth.data.tables import find_header, has_header, read_lines, read_table
from zoedepth.errors import InputError

NAMES = ["image", "depth", "depth_scale", "domain"]
VALUES = ["image/1.jpg", "depth/1.png", "1000", "indoor"]
ROW = dict(zip(NAMES, VALUES, strict=True))


def write(folder: Path, *rows: list[str], separator: str = ",", encoding: str = "utf-8") -> Path:
    path = folder / "list.csv"
    path.write_bytes("".join(separator.join(row) + "\r\n" for row in rows).encode(encoding))
    return path


def rows(path: Path) -> list[dict[str, str]]:
    return [row for _, row in read_table(path)]


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", ", ", " ; "])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_any_usual_separator_and_encoding(tmp_path: Path, separator: str, encoding: str) -> None:
    path = write(tmp_path, NAMES, ["Küche/1.jpg", *VALUES[1:]], separator=separator, encoding=encoding)
    assert rows(path) == [{**ROW, "image": "Küche/1.jpg"}]


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_mark_of_utf_16_says_the_order_of_its_bytes(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path, ["\ufeffimage", "depth"], ["a", "b"], separator="\t", encoding=encoding)
    assert rows(path) == [{"image": "a", "depth": "b"}]


@pytest.mark.parametrize("names", [["Image", "DEPTH", "Depth Scale", "Domain"], [' "image"', '"depth" ', *NAMES[2:]]])
def test_capitals_blanks_and_quotation_marks_do_not_count(tmp_path: Path, names: list[str]) -> None:
    assert rows(write(tmp_path, names, [f"  {VALUES[0]} ", *VALUES[1:]])) == [ROW]


def test_values_in_quotation_marks_may_have_the_separator(tmp_path: Path) -> None:
    assert rows(write(tmp_path, ["image", "depth"], ['"a, b.jpg"', "c.png"])) == [
        {"image": "a, b.jpg", "depth": "c.png"}
    ]


def test_empty_rows_and_columns_are_left_out_and_counted(tmp_path: Path) -> None:
    path = write(tmp_path, [""], [*NAMES, "", ""], [""] * 6, [*VALUES, "", ""], ["", ""], VALUES)
    assert list(read_table(path)) == [(f"{path}, line 4", ROW), (f"{path}, line 6", ROW)]


def test_excels_own_line_about_the_separator_is_left_out(tmp_path: Path) -> None:
    assert rows(write(tmp_path, ["sep="], NAMES, VALUES, separator=";")) == [ROW]
    path = tmp_path / "list.csv"
    path.write_text("sep=;\nimage;depth\na;b\n")
    assert list(read_table(path)) == [(f"{path}, line 3", {"image": "a", "depth": "b"})]


def test_column_of_numbers_before_the_others_needs_no_name(tmp_path: Path) -> None:
    assert rows(write(tmp_path, ["", *NAMES], ["0", *VALUES])) == [ROW]  # as pandas writes its index


@pytest.mark.parametrize("names", [NAMES, [*NAMES, ""]])
def test_more_values_than_columns_are_an_error(tmp_path: Path, names: list[str]) -> None:
    path = write(tmp_path, names, ["image/1.jpg", "depth/1.png", "1000", "5", "indoor"])  # a decimal comma
    with pytest.raises(InputError, match=r"line 2: has 'indoor' behind its last column, which is domain.*commas"):
        rows(path)


@pytest.mark.parametrize(
    ("text", "separator", "number"),
    [
        ("1000", ";", "1000"),
        ("256,5", ";", "256.5"),
        ("0,001", ";", "0.001"),
        ("1000,0", "\t", "1000.0"),
        ("1000.000", ";", "1000.000"),
        ("1.000", ",", "1.000"),
        ("1,5,5", ";", "1,5,5"),
    ],
)
def test_decimal_commas(tmp_path: Path, text: str, separator: str, number: str) -> None:
    path = write(tmp_path, NAMES, [*VALUES[:2], text, "indoor"], separator=separator)
    assert rows(path) == [{**ROW, "depth_scale": number}]


@pytest.mark.parametrize(("text", "separator"), [("1.000", ";"), ("5.000", "\t"), ("1,000", ";"), ('"1,000"', ",")])
def test_number_that_means_another_in_another_country_is_an_error(tmp_path: Path, text: str, separator: str) -> None:
    path = write(tmp_path, NAMES, [*VALUES[:2], text, "indoor"], separator=separator)
    with pytest.raises(InputError, match=r"line 2: depth_scale '.[.,]000' is .000 in some countries and . in others"):
        rows(path)


@pytest.mark.parametrize(("text", "separator"), [("518,858", ";"), ("518.858", ";"), ("518.858", ",")])
def test_no_focal_length_has_thousands(tmp_path: Path, text: str, separator: str) -> None:
    path = write(tmp_path, ["image", "depth", "fx"], ["a", "b", text], separator=separator)
    assert rows(path)[0]["fx"] == "518.858"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("image/1.jpg,depth/1.png,1000,indoor\n", "line 1: the first line must name the columns.*'image/1.jpg,depth"),
        ("\nimage depth\n", "line 2: the first line must name the columns.*'image depth'"),
        ("Bild;Tiefe\n", "'Bild;Tiefe'"),
        ("image,depth,Depth\n", "line 1: has two columns depth"),
        ('image,depth\n"a,b\nc,d\n', "line 3: not CSV, check its quotation marks"),
    ],
)
def test_table_without_columns_or_with_odd_ones_is_an_error(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=word):
        rows(path)


def test_header_is_told_by_the_names_of_photo_and_depth(tmp_path: Path) -> None:
    assert find_header("rgb\tDisparity\n").names == ("rgb", "disparity")
    assert find_header("image.jpg depth.png 518") is None
    assert not has_header(write(tmp_path, [""]))
    assert has_header(write(tmp_path, [""], NAMES))


def test_text_in_another_encoding_is_an_error_that_says_which(tmp_path: Path) -> None:
    path = write(tmp_path, NAMES, ["Küche.jpg", *VALUES[1:]], encoding="latin-1")
    with pytest.raises(InputError, match=r"list\.csv is not a CSV file in UTF-8.*save it again in UTF-8"):
        list(read_lines(path))
