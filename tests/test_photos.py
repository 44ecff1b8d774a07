"""Photos of folders, files and globs: each is found once, and none gets the files of another."""

import glob
import os
from pathlib import Path

import pytest
from tests.folders import write_photo

from zoedepth.errors import InputError
from zoedepth.images import read_image
from zoedepth.panorama import is_sphere
from zoedepth.photos import Found, NamesInMemory, find_photos, walk_photos

# The tests make a pipe, and os.mkfifo is not there on Windows, whose pipes lie in no folder: there is nothing to test.
NEEDS_PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes in folders")


class TestFindPhotos:
    def targets(self, *sources: object, out: Path) -> dict[str, str]:
        """Photo -> target, relative to the folder of the test."""
        found = find_photos([str(source) for source in sources], out)
        assert not found.failures
        return {
            photo.path.relative_to(out.parent).as_posix(): photo.target.relative_to(out).as_posix()
            for photo in found.photos
        }

    def test_photos_that_would_share_outputs_keep_their_suffix(self, tmp_path: Path) -> None:
        for name in ("a.jpg", "a.png", "A.bmp", "b.jpg", "a.jpg.png", "sub/a.jpg"):
            (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / name).touch()
        targets = self.targets(tmp_path / "in", out=tmp_path / "out")
        assert {source.removeprefix("in/"): target for source, target in targets.items()} == {
            "A.bmp": "A.bmp",
            "a.jpg": "a.jpg",
            "a.jpg.png": "a.jpg.png",
            "a.png": "a.png",
            "b.jpg": "b",
            "sub/a.jpg": "sub/a",
        }

    def test_several_folders_keep_their_names(self, tmp_path: Path) -> None:
        for name in ("left/a.jpg", "right/a.jpg"):
            (tmp_path / name).parent.mkdir()
            (tmp_path / name).touch()
        targets = self.targets(tmp_path / "left", tmp_path / "right", out=tmp_path / "out")
        assert targets == {"left/a.jpg": "left/a", "right/a.jpg": "right/a"}
        targets = self.targets(tmp_path / "left/a.jpg", tmp_path / "right/a.jpg", out=tmp_path / "out")
        assert targets == {"left/a.jpg": "a.jpg", "right/a.jpg": "a.jpg-2"}

    def test_a_folder_is_called_as_it_was_typed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("vol7/a.jpg", "set1/sub/b.jpg"):
            (tmp_path / name).parent.mkdir(parents=True)
            (tmp_path / name).touch()
        (tmp_path / "set2").symlink_to("vol7")
        monkeypatch.chdir(tmp_path / "set1" / "sub")
        for sources in ((tmp_path / "set2", ".."), (tmp_path / "set2", tmp_path / "set1")):
            found = find_photos(map(str, sources), Path("out"))
            assert [photo.target.as_posix() for photo in found.photos] == ["out/set2/a", "out/set1/sub/b"]
        found = find_photos([".", str(tmp_path / "set2")], Path("out"))
        assert [photo.target.as_posix() for photo in found.photos] == ["out/sub/b", "out/set2/a"]

    def test_glob_keeps_the_tree_below_its_fixed_part(self, tmp_path: Path) -> None:
        for name in ("in/a/1.jpg", "in/b/1.JPG", "in/b/notes.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        targets = self.targets(tmp_path / "in" / "**" / "*", out=tmp_path / "out")
        assert targets == {"in/a/1.jpg": "a/1", "in/b/1.JPG": "b/1"}

    def test_glob_finds_what_pythons_own_does(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("a/1.jpg", "a/.2.jpg", "b/1.jpg", "b/c/1.jpg", ".d/1.jpg", "[e]/1.jpg", "1.jpg", "f1.jpg/1.jpg"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        monkeypatch.chdir(tmp_path)
        for pattern in (
            "*.jpg",
            "*/*.jpg",
            "*/1.jpg",
            "?/*",
            "b/*/1.jpg",
            ".d/*",
            ".*/*",
            "[[]e]/*",
            "none/*/*",
            "*/*/*",
        ):
            for source in (pattern, str(tmp_path / pattern)):
                expected = sorted(os.path.abspath(path) for path in glob.iglob(source) if os.path.isfile(path))
                found = [os.path.abspath(photo.path) for photo in find_photos([source], tmp_path / "out").photos]
                assert found == expected, source

    def test_relative_sources(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "here").mkdir()
        for name in ("a.jpg", "here/b.jpg"):
            (tmp_path / name).touch()
        monkeypatch.chdir(tmp_path / "here")
        for sources in ([".."], ["../*.jpg", "*.jpg"], ["./*.jpg", "../a.jpg"]):
            found = find_photos(sources, Path("out"))
            assert {photo.path.name for photo in found.photos} == {"a.jpg", "b.jpg"}

    def test_each_photo_once(self, tmp_path: Path) -> None:
        (tmp_path / "a.jpg").touch()
        sources = (tmp_path / "a.jpg", tmp_path, tmp_path / "*.jpg", tmp_path / "a.jpg")
        assert self.targets(*sources, out=tmp_path / "out") == {"a.jpg": "a"}

    def test_folder_that_cannot_be_read_is_reported(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_photo(tmp_path / "closed" / "a.jpg")
        write_photo(tmp_path / "open" / "b.jpg")
        scandir = os.scandir

        def refuse(folder: str) -> object:  # not by its mode: root, who runs tests in containers, may read everything
            if Path(folder).name == "closed":
                raise PermissionError(13, "Permission denied", folder)
            return scandir(folder)

        monkeypatch.setattr(os, "scandir", refuse)
        found = find_photos([str(tmp_path)], tmp_path / "out")
        assert [photo.path.name for photo in found.photos] == ["b.jpg"]
        assert "closed" in found.failures[0]

    def test_links_are_followed_by_folders_and_by_globs_and_each_photo_is_found_once(self, tmp_path: Path) -> None:
        """Two loops make Python's own glob go 2^40 ways."""
        for name in ("disk/a.jpg", "in/b.jpg"):
            (tmp_path / name).parent.mkdir()
            (tmp_path / name).touch()
        for name, target in (("day1", "../disk"), ("again", "../disk"), ("loop", "."), ("back", ".")):
            (tmp_path / "in" / name).symlink_to(target)
        for source in (tmp_path / "in", tmp_path / "in" / "**" / "*.jpg"):
            assert set(self.targets(source, out=tmp_path / "out").values()) == {"b", "again/a"}
        assert self.targets(tmp_path / "in", tmp_path / "disk", out=tmp_path / "o").keys() == {
            "in/b.jpg",
            "in/again/a.jpg",
        }

    def test_a_link_that_leads_nowhere_is_told(self, tmp_path: Path) -> None:
        (tmp_path / "day1").symlink_to("/mnt/not/there")
        found = find_photos([str(tmp_path)], tmp_path / "out")
        assert found.failures == [f"{tmp_path / 'day1'}: the link leads nowhere: is the disk there?"]

    def test_a_link_in_a_glob_that_leads_nowhere_is_tried(self, tmp_path: Path) -> None:
        (tmp_path / "a.jpg").symlink_to("/mnt/not/there.jpg")
        (tmp_path / "b.jpg").mkdir()
        for source in (str(tmp_path), str(tmp_path / "*.jpg")):
            found = find_photos([source], tmp_path / "out")
            assert [photo.path.name for photo in found.photos] == ["a.jpg"]

    @NEEDS_PIPES
    def test_pipes_are_left_out(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "a.jpg")
        for source in (str(tmp_path), str(tmp_path / "*.jpg")):
            found = find_photos([source], tmp_path / "out")
            assert (found.photos, dict(found.left_out)) == ([], {"pipes and devices, which are no files": 1})

    @NEEDS_PIPES
    def test_a_pipe_that_is_named_is_refused_and_not_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "a.jpg")
        (photo,) = find_photos([str(tmp_path / "a.jpg")], tmp_path / "out").photos
        for read in (is_sphere, read_image):
            with pytest.raises(InputError, match=r"a\.jpg is a pipe or a device.*save the photo as a file"):
                read(photo.path)

    def test_what_other_programs_keep_is_left_out_of_folders_and_globs(self, tmp_path: Path) -> None:
        for name in ("a.jpg", "@eaDir/a.jpg/SYNOPHOTO_THUMB_XL.jpg", "b/#recycle/c.jpg", "b/._d.jpg"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        sources = [str(tmp_path), str(tmp_path / "**" / "*.jpg"), str(tmp_path / "*" / "*" / "*.jpg")]
        for source, photos in zip(sources, (["a.jpg"], ["a.jpg"], []), strict=True):
            found = find_photos([source], tmp_path / "out")
            assert [photo.path.name for photo in found.photos] == photos
            assert found.n_ignored == found.left_out.total() >= 2
            assert "#recycle" in str(found.left_out)
        assert len(find_photos([str(tmp_path / "@eaDir")], tmp_path / "out").photos) == 1  # asked for

    @pytest.mark.parametrize(
        ("name", "advice"),
        [("a.xyz", "files of other kinds"), ("a.CR3", "raw"), ("a.mp4", "ffmpeg"), ("a.zip", "unpack")],
    )
    def test_files_that_are_no_photos_are_counted_with_advice(self, tmp_path: Path, name: str, advice: str) -> None:
        for folder in ("1", "2"):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / name).touch()
        ((reason, number),) = find_photos([str(tmp_path)], tmp_path / "out").left_out.items()
        assert advice in reason
        assert number == 2

    def test_names_that_a_disk_may_take_for_one_get_files_of_their_own(self, tmp_path: Path) -> None:
        composed, decomposed = "\u00e9.jpg", "e\u0301.png"
        for name in (composed, decomposed, "B.jpg", "b.png"):
            (tmp_path / name).touch()
        assert self.targets(tmp_path, out=tmp_path / "out") == {
            name: name for name in (composed, decomposed, "B.jpg", "b.png")
        }


def test_photos_are_found_one_folder_after_the_other(tmp_path: Path) -> None:
    for name in ("a/1.jpg", "a/1.png", "b/1.jpg"):
        write_photo(tmp_path / name)
    found = Found()
    walked = walk_photos([str(tmp_path)], found, seen=NamesInMemory(), taken=NamesInMemory(), above="x")
    path, place, target = next(walked)
    write_photo(tmp_path / "b" / "2.jpg")  # not yet listed
    assert (path, place, target) == (tmp_path / "a" / "1.jpg", Path("x/a/1.jpg"), Path("x/a/1.jpg"))
    assert [target.as_posix() for _, _, target in walked] == ["x/a/1.png", "x/b/1", "x/b/2"]
