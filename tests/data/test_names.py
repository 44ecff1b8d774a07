"""The file that a name means: slashes, roots, and letters that only look the same."""

import unicodedata
from pathlib import Path

import pytest

from zoedepth.data.names import Finder, composed, other_capitals
from zoedepth.errors import InputError

COMPOSED, APART = (unicodedata.normalize(form, "Küche") for form in ("NFC", "NFD"))


def touch(folder: Path, name: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def find(root: Path, name: object, **options: bool) -> Path:
    return Finder(root, **{"anywhere": True, **options}).find(name, "here")


def test_backslashes_are_slashes_unless_a_file_has_one(tmp_path: Path) -> None:
    assert find(tmp_path, r"image\1.jpg") == tmp_path / "image/1.jpg"
    odd = touch(tmp_path, r"odd\1.jpg")
    assert find(tmp_path, r"odd\1.jpg") == odd


def test_own_list_may_point_anywhere(tmp_path: Path) -> None:
    assert find(tmp_path / "lists", "../a.jpg") == tmp_path / "lists/../a.jpg"
    assert find(tmp_path / "lists", str(tmp_path / "a.jpg")) == tmp_path / "a.jpg"


@pytest.mark.parametrize("name", ["../a.jpg", "b/../../a.jpg", "/a.jpg", r"..\a.jpg", r"b\..\..\a.jpg"])
def test_list_from_elsewhere_may_not(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"here: .*inside the folder of the list.*--root"):
        find(tmp_path, name, anywhere=False)


def test_absolute_path_inside_the_root_is_inside(tmp_path: Path) -> None:
    assert find(tmp_path, str(tmp_path / "a.jpg"), anywhere=False) == tmp_path / "a.jpg"


@pytest.mark.parametrize("name", [r"C:\data\a.jpg", "c:/data/a.jpg"])
def test_path_of_another_system_is_an_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="a path of a Windows system"):
        find(tmp_path, name)


def test_name_in_other_capitals(tmp_path: Path) -> None:
    touch(tmp_path, "IMG_1.JPG")
    assert other_capitals(tmp_path / "img_1.jpg") == tmp_path / "IMG_1.JPG"
    assert other_capitals(tmp_path / "img_2.jpg") is other_capitals(tmp_path / "none" / "img_1.jpg") is None


@pytest.mark.parametrize("name", [3, None, ["a"], True])
def test_name_must_be_text(tmp_path: Path, name: object) -> None:
    with pytest.raises(InputError, match=r"here: .*must be text"):
        find(tmp_path, name)


class TestLeadingSlash:
    """In the lists of BTS a slash begins a path below a folder; in others, a path of this machine."""

    def test_it_may_be_below_the_root(self, tmp_path: Path) -> None:
        assert find(tmp_path, "/a.jpg", leading_slash=True) == tmp_path / "a.jpg"
        assert find(tmp_path, "//etc/../a.jpg", leading_slash=True) == tmp_path / "etc/../a.jpg"

    def test_it_is_absolute_where_there_is_such_a_file(self, tmp_path: Path) -> None:
        absolute = touch(tmp_path, "photos/a.jpg")
        assert find(tmp_path / "lists", str(absolute), leading_slash=True) == absolute
        below = tmp_path / "lists" / str(absolute).lstrip("/")
        assert find(tmp_path / "lists", str(absolute), leading_slash=True, anywhere=False) == below

    def test_two_files_are_an_error(self, tmp_path: Path) -> None:
        absolute = touch(tmp_path, "photos/a.jpg")
        touch(tmp_path / "lists", str(absolute).lstrip("/"))
        with pytest.raises(InputError, match=f"here: '{absolute}' may be"):
            find(tmp_path / "lists", str(absolute), leading_slash=True)


class TestLettersThatLookTheSame:
    @pytest.mark.parametrize(("stored", "said"), [(COMPOSED, APART), (APART, COMPOSED)], ids=["composed", "apart"])
    @pytest.mark.parametrize("place", ["{}.jpg", "{}/1.jpg", "a/{}/{}/1.jpg"])
    def test_they_mean_one_file(self, tmp_path: Path, stored: str, said: str, place: str) -> None:
        path = touch(tmp_path, place.replace("{}", stored))
        found = find(tmp_path, place.replace("{}", said))
        assert found.is_file()
        assert found.samefile(path)

    def test_of_two_files_the_one_that_is_named_is_meant(self, tmp_path: Path) -> None:
        for name in (COMPOSED, APART):
            path = touch(tmp_path, f"{name}.jpg")
            assert find(tmp_path, f"{name}.jpg") == path

    def test_two_that_are_alike_and_neither_named_are_an_error(self, tmp_path: Path) -> None:
        letters = "ệ"  # may be composed in part
        both = [unicodedata.normalize("NFC", letters), unicodedata.normalize("NFD", letters)]
        for name in both:
            touch(tmp_path, name)
        partly = "ẹ\N{COMBINING CIRCUMFLEX ACCENT}"
        assert partly not in both
        if len(list(tmp_path.iterdir())) < 2:  # macOS keeps one of the two: nothing can be confused
            assert find(tmp_path, partly).exists()
            return
        with pytest.raises(InputError, match=r"has 2 names that look like.*NFC, NFD"):
            find(tmp_path, partly)

    def test_name_without_a_file_is_kept(self, tmp_path: Path) -> None:
        for name in (COMPOSED, f"{COMPOSED}/1.jpg", f"a/{APART}"):
            assert find(tmp_path, name) == tmp_path / name

    def test_composed_leaves_plain_letters_alone(self) -> None:
        assert (composed("abc"), composed(APART), composed(COMPOSED)) == ("abc", COMPOSED, COMPOSED)


def test_a_link_that_leads_nowhere_is_not_its_own_name_in_other_capitals(tmp_path: Path) -> None:
    (tmp_path / "c.jpg").symlink_to(tmp_path / "gone.jpg")
    assert other_capitals(tmp_path / "c.jpg") is None
