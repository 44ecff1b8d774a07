"""Folders as they are on people's disks: with links, loops, and what other programs keep in them."""

import errno
import os
from pathlib import Path, PurePath

import pytest

from zoedepth.errors import InputError
from zoedepth.folders import check_writable, list_files, service_folder


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def found(folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in list_files(folder).files]


class TestLinks:
    def test_to_a_folder_elsewhere_are_followed(self, tmp_path: Path) -> None:
        touch(tmp_path, "disk/day1/a.jpg", "disk/day1/b/c.jpg", "in/z.jpg")
        (tmp_path / "in" / "day1").symlink_to("../disk/day1")
        assert found(tmp_path / "in") == ["z.jpg", "day1/a.jpg", "day1/b/c.jpg"]

    @pytest.mark.parametrize("target", [".", "..", "../.."])
    def test_that_lead_back_up_are_counted(self, tmp_path: Path, target: str) -> None:
        touch(tmp_path, "in/deep/a.jpg")
        (tmp_path / "in" / "deep" / "loop").symlink_to(target)
        assert found(tmp_path / "in") == ["deep/a.jpg"]
        assert list_files(tmp_path / "in").left_out == {"links that lead back up": 1}

    def test_to_themselves_are_files_to_the_system(self, tmp_path: Path) -> None:
        (tmp_path / "loop").symlink_to("loop")
        assert found(tmp_path) == ["loop"]

    def test_to_one_folder_are_followed_once_and_the_folder_itself_comes_first(self, tmp_path: Path) -> None:
        touch(tmp_path, "disk/a.jpg", "in/z/b.jpg")
        for name in ("first", "second"):
            (tmp_path / "in" / name).symlink_to("../disk")
        (tmp_path / "in" / "alias").symlink_to("z")
        assert found(tmp_path / "in") == ["z/b.jpg", "first/a.jpg"]
        assert list_files(tmp_path / "in").left_out == {"links to folders that were searched already": 2}

    def test_between_two_folders_end(self, tmp_path: Path) -> None:
        touch(tmp_path, "one/a.jpg", "two/b.jpg")
        (tmp_path / "one" / "there").symlink_to("../two")
        (tmp_path / "two" / "back").symlink_to("../one")
        assert found(tmp_path / "one") == ["a.jpg", "there/b.jpg"]

    def test_the_folder_itself_may_be_one(self, tmp_path: Path) -> None:
        touch(tmp_path, "disk/a.jpg")
        (tmp_path / "in").symlink_to("disk")
        assert found(tmp_path / "in") == ["a.jpg"]


@pytest.mark.parametrize(
    ("path", "service"),
    [
        ("@eaDir/IMG_1.jpg", "@eaDir"),
        ("2020/#recycle", "#recycle"),
        ("a/@Recently-Snapshot/b", "@Recently-Snapshot"),
        ("__MACOSX", "__MACOSX"),
        ("$RECYCLE.BIN/S-1", "$RECYCLE.BIN"),
        ("Catalog Previews.lrdata/0/0A", "Catalog Previews.lrdata"),
        ("Photos Library.photoslibrary/resources/derivatives", "resources"),
        ("Photos Library.photoslibrary/originals/0", None),
        ("M4ROOT/THMBNL", "THMBNL"),
        ("holidays @home/#1", None),
        (".", None),
    ],
)
def test_folders_of_other_programs_are_known_by_name(path: str, service: str | None) -> None:
    assert service_folder(PurePath(path)) == service


def test_what_is_left_out_is_counted(tmp_path: Path) -> None:
    thumbnails = ("@eaDir/a.jpg/SYNOPHOTO_THUMB_M.jpg", "@eaDir/a.jpg/SYNOPHOTO_THUMB_XL.jpg")
    touch(tmp_path, "a.jpg", "._a.jpg", ".DS_Store", ".thumbnails/x/a.png", *thumbnails)
    listing = list_files(tmp_path)
    assert [path.name for path in listing.files] == ["a.jpg"]
    assert listing.left_out == {"hidden": 3, "in @eaDir, where another program keeps its files": 2}


def test_a_service_folder_can_be_named_itself(tmp_path: Path) -> None:
    touch(tmp_path, "@eaDir/a.jpg", ".hidden/b.jpg")
    assert found(tmp_path / "@eaDir") == ["a.jpg"]
    assert found(tmp_path / ".hidden") == ["b.jpg"]


class TestCheckWritable:
    def test_leaves_nothing(self, tmp_path: Path) -> None:
        check_writable(tmp_path)
        check_writable(tmp_path / "not" / "yet")
        assert list(tmp_path.iterdir()) == []

    def test_a_file_on_the_way_is_named(self, tmp_path: Path) -> None:
        (tmp_path / "file").touch()
        with pytest.raises(InputError, match="file is no folder"):
            check_writable(tmp_path / "file" / "out")
        (tmp_path / "link").symlink_to(tmp_path / "nowhere")
        with pytest.raises(InputError, match=r"^--sheet: cannot write to .*link is no folder"):
            check_writable(tmp_path / "link/below", option="--sheet")

    def test_a_full_disk_is_noticed_when_bytes_are_written(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def full(_: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=os.strerror(errno.ENOSPC)):
            check_writable(tmp_path)
