"""Text lists: names with blanks, the lists of TUM RGB-D, comments, and lines that may mean this or that."""

from pathlib import Path

import pytest

from zoedepth.data.text_lists import FOCAL, read_text_list
from zoedepth.errors import InputError


def pairs(folder: Path, text: str, name: str = "list.txt") -> list[tuple[str, str]]:
    return [(row["image"], row["depth"]) for row in rows(folder, text, name)]


def rows(folder: Path, text: str, name: str = "list.txt") -> list[dict[str, str]]:
    (folder / name).write_text(text)
    return [row for _, row in read_text_list(folder / name, folder)]


@pytest.mark.parametrize(
    "line",
    [
        "my room/rgb/0.jpg my room/depth/0.png",
        "my room/rgb/0.jpg my room/depth/0.png 518.8579",
        "my room/rgb/0.jpg   my room/depth/0.png  518.8579",
        "my room/rgb/0.jpg\tmy room/depth/0.png\t518.8579",
        '"my room/rgb/0.jpg" "my room/depth/0.png" 518.8579',
    ],
)
def test_names_may_have_blanks(tmp_path: Path, line: str) -> None:
    focal = {FOCAL: "518.8579"} if "518" in line else {}
    assert rows(tmp_path, f"{line}\n") == [{"image": "my room/rgb/0.jpg", "depth": "my room/depth/0.png", **focal}]


def test_name_with_blanks_may_have_no_depth(tmp_path: Path) -> None:
    assert pairs(tmp_path, "my room/0.jpg None 518\n") == [("my room/0.jpg", "None")]


def test_of_many_ways_to_cut_a_line_the_one_with_files_is_taken(tmp_path: Path) -> None:
    line = "a.png b.png c.png\n"
    with pytest.raises(InputError, match=r"list\.txt, line 1: cannot tell.*'a.png b.png c.png'.*quotation marks"):
        pairs(tmp_path, line)
    for name in ("a.png b.png", "c.png"):
        (tmp_path / name).touch()
    assert pairs(tmp_path, line) == [("a.png b.png", "c.png")]
    for name in ("a.png", "b.png c.png"):
        (tmp_path / name).touch()
    with pytest.raises(InputError, match="cannot tell"):
        pairs(tmp_path, line)


def test_comments_and_empty_lines_are_left_out_and_counted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 4: needs a photo and its depth.*'c\.jpg'"):
        pairs(tmp_path, "# color images\n\na.jpg b.png\nc.jpg\n")


@pytest.mark.parametrize("rest", ["", " 0.1 0.2 0.3 0 0 0 1"], ids=["four columns", "with a pose"])
def test_associations_of_tum(tmp_path: Path, rest: str) -> None:
    line = "1305031102.175304 rgb/1305031102.175304.png 1305031102.160407 depth/1305031102.160407.png"
    found = rows(tmp_path, f"# associated\n{line}{rest}\n")
    assert found == [{"image": "rgb/1305031102.175304.png", "depth": "depth/1305031102.160407.png"}]


def test_folders_say_where_depth_comes_first(tmp_path: Path) -> None:
    assert pairs(tmp_path, "1 depth/1.png 1 rgb/1.png\n") == [("rgb/1.png", "depth/1.png")]
    assert pairs(tmp_path, "depth/1.png rgb/1.png\n") == [("rgb/1.png", "depth/1.png")]
    assert pairs(tmp_path, "depth/rgb/1.png maps/1.png\n") == [("depth/rgb/1.png", "maps/1.png")]


def test_list_of_times_goes_with_that_of_depth_beside_it(tmp_path: Path) -> None:
    (tmp_path / "depth.txt").write_text("# depth maps\n100.51 depth/100.51.png\n101.51 depth/101.51.png\n")
    text = "# color images\n100.50 rgb/100.50.png\n101.00 rgb/101.00.png\n101.50 rgb/101.50.png\n"
    assert pairs(tmp_path, text, "rgb.txt") == [
        ("rgb/100.50.png", "depth/100.51.png"),
        ("rgb/101.50.png", "depth/101.51.png"),
    ]


def test_list_of_times_without_the_other_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    text = "100.50 rgb/100.50.png\n"
    for name in ("rgb.txt", "depth.txt"):
        with pytest.raises(InputError, match=rf"{name} has times and one file a line.*rgb\.txt.*depth\.txt"):
            pairs(tmp_path, text, name)
    (tmp_path / "depth.txt").write_text("200.5 depth/200.5.png\n")
    with pytest.raises(InputError, match=r"no photo and depth within 0\.02 s"):
        pairs(tmp_path, text, "rgb.txt")
    (tmp_path / "depth.txt").write_text("200.5 1 2 3\n")
    with pytest.raises(InputError, match=r"depth\.txt, line 1: must be a time and a file"):
        pairs(tmp_path, text, "rgb.txt")


@pytest.mark.parametrize("line", ["1.5 0.1 0.2 0.3 0 0 0 1", "a b c", "x " * 20_000])
def test_line_that_is_no_pair_is_an_error(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError, match="line 1: cannot tell where the photo ends"):
        pairs(tmp_path, f"{line}\n")
