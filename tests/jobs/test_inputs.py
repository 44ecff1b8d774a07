"""Inputs: found in folders, lists, archives and stores, one after the other, each once, each at its place."""

import io
import os
import sys
import tarfile
import unicodedata
import zipfile
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from tests.jobs.photos import run, write_photo, write_photos

from zoedepth import folders
from zoedepth.errors import InputError
from zoedepth.jobs import inputs as listing
from zoedepth.jobs.inputs import Sources
from zoedepth.jobs.shard import JobShard


def found(*sources: object, column: str | None = None, out: str = "") -> dict[str, str]:
    """Name → target, of all inputs, which must each be listed once."""
    listed = list(Sources(tuple(map(str, sources)), column, out=out).inputs())
    assert len({each.name for each in listed}) == len(listed)
    return {each.name: each.target.as_posix() for each in listed}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_photos(tmp_path / "in")


def members(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in sorted(folder.rglob("*.png"))}


def write_tar(path: Path, files: dict[str, bytes], mode: str = "w") -> Path:
    with tarfile.open(path, mode) as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size, info.mtime = len(content), 1234567890
            archive.addfile(info, io.BytesIO(content))
    return path


def write_zip(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


class TestHere:
    def test_folders_globs_and_photos_are_found_as_by_find_photos(
        self, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        photo = write_photo(tmp_path / "day 0" / "x.png")
        monkeypatch.chdir(tmp_path)
        expected = {str(folder / f"day {i % 2}" / f"{i}.png"): f"day {i % 2}/{i}" for i in range(4)}
        assert found("in") == found("in/**/*.png") == expected
        assert found("in", photo) == {**expected, str(photo): "x"}
        two = found("in", "day 0")
        assert two == {name: f"in/{target}" for name, target in expected.items()} | {str(photo): "day 0/x"}

    def test_the_first_is_there_before_the_second_folder_is_listed(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        listed = []
        walk = folders.os.walk

        def noted(*arguments: object, **options: object) -> Iterator[object]:
            for entry in walk(*arguments, **options):
                listed.append(Path(entry[0]).name)
                yield entry

        monkeypatch.setattr(folders.os, "walk", noted)
        first = next(Sources((str(folder),)).inputs())
        assert first.path.name == "0.png"
        assert listed == ["in", "day 0"]

    def test_what_cannot_be_read_is_kept(self, folder: Path) -> None:
        sources = Sources((str(folder), str(folder / "none.jpg"), str(folder / "*.jpg")))
        (folder / "notes.doc").touch()
        assert len(list(sources.inputs())) == 4
        assert sources.found.failures == [
            f"{folder / 'none.jpg'}: no such file or folder", f"{folder / '*.jpg'}: matches no file",
        ]  # fmt: skip
        assert sources.found.left_out == {"files of other kinds": 1}

    def test_shards_have_each_once(self, folder: Path) -> None:
        shards = [list(Sources((str(folder),), shard=JobShard(i, 3)).inputs()) for i in range(3)]
        names = [each.name for shard in shards for each in shard]
        assert sorted(names) == sorted(found(folder))
        targets = {each.name: each.target.as_posix() for shard in shards for each in shard}
        assert targets == found(folder)

    def test_shards_know_the_same_first_inputs(self, folder: Path, tmp_path: Path) -> None:
        shards = [Sources((str(folder),), shard=JobShard(i, 3)) for i in range(3)]
        assert [each.firsts for each in shards] == [[]] * 3
        listed = [list(each.inputs()) for each in shards]
        archive = Sources((str(write_zip(tmp_path / "a.zip", members(folder))),), shard=JobShard(0, 100_000))
        assert list(archive.inputs()) == []
        expected = sorted(each.place for shard in listed for each in shard)
        assert [[each.place for each in sources.firsts] for sources in (*shards, archive)] == [expected] * 4

    def test_comments_in_a_list_are_no_photos(self, folder: Path, tmp_path: Path) -> None:
        first, *_ = sorted(folder.rglob("*.png"))
        (tmp_path / "#2.png").write_bytes(first.read_bytes())
        (tmp_path / "list.txt").write_text(f"# time photo\n{first}\n#2.png\n#3.png\n")
        assert list(found(tmp_path / "list.txt")) == [str(first), str(tmp_path / "#2.png")]

    def test_shards_are_the_same_where_a_source_is_a_link(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The folder ``set2`` of one machine may be a link to ``vol7`` on the other; archives as well."""
        places = []
        for machine, real in (("a", "set2"), ("b", "vol7")):
            here = tmp_path / machine
            write_photos(here / "set1")
            write_photos(here / real)
            write_zip(here / f"{real}.zip", members(here / real))
            if real != "set2":
                (here / "set2").symlink_to(real)
                (here / "set2.zip").symlink_to(f"{real}.zip")
            monkeypatch.chdir(here)
            for sources in (("set1", "set2"), ("./set1/", "set2/"), ("set1", "set2.zip")):
                places.append({str(each.place) for each in Sources(sources, shard=JobShard(0, 2)).inputs()})
            monkeypatch.chdir(here / "set1")
            places.append({str(each.place) for each in Sources((".", "../set2"), shard=JobShard(0, 2)).inputs()})
        assert places[0]
        assert all(each == places[0] for each in places)

    def test_it_is_counted_without_a_second_word_about_what_failed(self, folder: Path) -> None:
        sources = Sources((str(folder), str(folder / "none.jpg")))
        list(sources.inputs())
        sources.known = lambda name: pytest.fail("another thread asked the manifest")
        assert sum(1 for _ in sources.count()) == 4
        assert len(sources.found.failures) == 1

    @pytest.mark.parametrize(
        ("names", "named"), [(("a.jpg", "b.png"), True), (("a.jpg", "."), False), (("*.jpg",), False),
                             (("s3://b/a.jpg", "https://a.org/x"), True), (("s3://b/a",), False)],
    )  # fmt: skip
    def test_photos_that_are_named(self, names: tuple[str, ...], named: bool) -> None:
        assert Sources(names).named == named


class TestLists:
    def test_text_csv_and_parquet(self, folder: Path, tmp_path: Path) -> None:
        names = [f"in/day {i % 2}/{i}.png" for i in range(4)]
        expected = {str(tmp_path / name): name.removesuffix(".png") for name in names}
        (tmp_path / "a.txt").write_text("\ufeff" + "\n".join([*names, "", f"  {names[0]}  "]) + "\n")
        assert found(tmp_path / "a.txt") == expected
        (tmp_path / "a.csv").write_text("id,photo\n" + "".join(f'{i},"{name}"\n' for i, name in enumerate(names)))
        (tmp_path / "a.tsv").write_text("x\ty\n" + "".join(f"{name}\t{i}\n" for i, name in enumerate(names)))
        assert found(tmp_path / "a.csv") == found(tmp_path / "a.tsv", column="x") == expected
        pyarrow = pytest.importorskip("pyarrow")
        table = pyarrow.table({"n": [1, 2, 3, 4, 5], "image": [*names, None]})
        pytest.importorskip("pyarrow.parquet").write_table(table, tmp_path / "a.parquet")
        assert found(tmp_path / "a.parquet") == expected
        assert run(tmp_path / "a.parquet", out=tmp_path / "out")[1].done == 4
        assert (tmp_path / "out" / "in" / "day 1" / "3_depth.npy").is_file()

    def test_addresses_and_paths_from_the_root(self, tmp_path: Path) -> None:
        photo = write_photo(tmp_path / "a.png")
        (tmp_path / "list.txt").write_text(f"{photo}\ns3://bucket/x/b.jpg\n../c.jpg\n")
        assert found(tmp_path / "list.txt") == {
            str(photo): photo.as_posix().removeprefix("/").removesuffix(".png"),
            "s3://bucket/x/b.jpg": "bucket/x/b",
            str(tmp_path.parent / "c.jpg"): "c",
        }

    def test_photos_that_would_share_files_get_names_of_their_own(self, tmp_path: Path) -> None:
        (tmp_path / "list.txt").write_text("x/a.jpg\nx/a.png\n../x/a.jpg\n")
        assert list(found(tmp_path / "list.txt").values()) == ["x/a.jpg", "x/a.png", "x/a.jpg-2"]

    @pytest.mark.parametrize(
        ("text", "column", "message"),
        [("a,b\n1,2\n", None, "has the columns a, b: say which"), ("", None, "is empty"),
         ("image\n1\n", "imgae", "did you mean image"),
         ("x.jpg\ny.jpg\n", None, "begins with x.jpg, a photo, where the names of its columns belong"),
         ("x.jpg,1\ny.jpg,2\n", "x.jpg", "give it a first line")],
    )  # fmt: skip
    def test_a_table_without_a_column_of_photos(
        self, tmp_path: Path, text: str, column: str | None, message: str
    ) -> None:
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(InputError, match=message):
            found(tmp_path / "a.csv", column=column)

    def test_names_are_found_however_they_are_written(self, tmp_path: Path) -> None:
        accent = "caf\u00e9.png"  # as a Mac writes it into lists; its disk and archives have e and an accent
        for name in (unicodedata.normalize("NFD", accent), "a.png"):
            write_photo(tmp_path / "day 1" / name)
        (tmp_path / "list.txt").write_text(f"day 1/{accent}\nday 1\\a.png\nC:\\a.png\n", encoding="utf-8")
        sources = Sources((str(tmp_path / "list.txt"),))
        assert all(each.path.is_file() for each in sources.inputs())
        assert list(sources.found.unreadable) == ["C:\\a.png"]
        assert "is a path of a Windows system" in sources.found.failures[0]

    # Linux keeps names as bytes, of any kind. macOS and Windows refuse to make a file of this name.
    @pytest.mark.skipif(sys.platform != "linux", reason="Windows and macOS keep names as Unicode")
    def test_one_name_that_is_not_utf8_does_not_lose_the_others(self, tmp_path: Path) -> None:
        odd = os.fsdecode(b"caf\xe9.png")
        for name in (odd, "a.png"):
            write_photo(tmp_path / name)
        (tmp_path / "list.txt").write_bytes(b"a.png\ncaf\xe9.png\n")  # as find > list.txt writes it
        assert set(found(tmp_path / "list.txt")) == {str(tmp_path / name) for name in (odd, "a.png")}

    @pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-8"])
    def test_lists_as_spreadsheets_and_shells_write_them(self, tmp_path: Path, encoding: str) -> None:
        write_photo(tmp_path / "a, b.png")
        rows = ["sep=;", "Note;Image", "1;a, b.png"]
        (tmp_path / "a.csv").write_text("\r\n".join(rows), encoding=encoding, newline="")
        (tmp_path / "a.txt").write_text("a, b.png\r\n", encoding=encoding, newline="")
        expected = {str(tmp_path / "a, b.png"): "a, b"}
        assert found(tmp_path / "a.csv") == found(tmp_path / "a.csv", column="Image") == expected
        assert found(tmp_path / "a.txt") == expected

    def test_lines_with_zero_bytes_do_not_lose_the_others(self, tmp_path: Path) -> None:
        write_photo(tmp_path / "1.png")
        (tmp_path / "l.txt").write_bytes(b"1.png\n" + bytes(4096))  # what a lost power leaves at the end of a file
        sources = Sources((str(tmp_path / "l.txt"),))
        assert [item.path.name for item in sources.inputs()] == ["1.png"]
        assert "has a zero byte" in sources.found.failures[0]
        (tmp_path / "l.txt").write_bytes("1.png\n".encode("utf-16-le"))
        sources = Sources((str(tmp_path / "l.txt"),))
        assert list(sources.inputs()) == []
        assert "UTF-16 without a mark at its beginning" in sources.found.failures[0]

    def test_a_list_that_is_no_text_is_told(self, tmp_path: Path) -> None:
        (tmp_path / "a.txt").write_bytes(b"\xff\xfe\x00")
        sources = Sources((str(tmp_path / "a.txt"),))
        assert list(sources.inputs()) == []
        assert "cannot be read to its end" in sources.found.failures[0]

    def test_a_parquet_file_without_its_library_is_an_error_that_names_the_extra(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "a.parquet").touch()
        monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
        with pytest.raises(ImportError, match=r"a\.parquet, a Parquet file, needs the extra \[cloud\]"):
            found(tmp_path / "a.parquet")


class TestArchives:
    OTHERS = {"notes.txt": b"1", ".hidden.png": b"1", "__MACOSX/a.png": b"1"}  # noqa: RUF012

    def test_members_are_predicted_as_files_are(self, folder: Path, tmp_path: Path) -> None:
        run(folder, out=tmp_path / "expected")
        files = members(folder) | self.OTHERS
        archives = [
            write_zip(tmp_path / "a.zip", files),
            write_tar(tmp_path / "b.tar", files),
            write_tar(tmp_path / "c.tar.gz", files, "w:gz"),
        ]
        for archive in archives:
            sources = Sources((str(archive),))
            assert {each.place.as_posix() for each in sources.inputs()} == members(folder).keys()
            assert sources.found.n_ignored == 3
            out = tmp_path / archive.stem
            assert run(archive, out=out, workers=2)[1].done == 4
            assert run(archive, out=out)[1].before == 4
            for array in (tmp_path / "expected").rglob("*.npy"):
                assert (out / array.relative_to(tmp_path / "expected")).read_bytes() == array.read_bytes()
        assert set(found(*archives[:2]).values()) == {
            f"{stem}/day {i % 2}/{i}" for stem in ("a", "b") for i in range(4)
        }

    def test_names_lead_nowhere_else(self, tmp_path: Path) -> None:
        files = {"../../a.png": b"1", "/etc/b.png": b"1", "c/../../d.png": b"1"}
        for archive in (write_zip(tmp_path / "a.zip", files), write_tar(tmp_path / "a.tar", files)):
            assert set(found(archive).values()) == {"a", "etc/b", "d"}

    @pytest.mark.parametrize(("ending", "mode"), [("tar", "w"), ("tar.gz", "w:gz")])
    def test_links_in_a_tar_file_are_counted(self, folder: Path, tmp_path: Path, ending: str, mode: str) -> None:
        content = members(folder)["day 0/0.png"]
        with tarfile.open(tmp_path / f"a.{ending}", mode) as archive:
            info = tarfile.TarInfo("a.png")
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
            links = {"b.png": tarfile.LNKTYPE, "c.png": tarfile.SYMTYPE, "notes": tarfile.LNKTYPE}
            for name, kind in {**links, "folder": tarfile.DIRTYPE}.items():
                info = tarfile.TarInfo(name)
                info.type, info.linkname = kind, "a.png"
                archive.addfile(info)
        sources = Sources((str(tmp_path / f"a.{ending}"),))
        assert [each.target.as_posix() for each in sources.inputs()] == ["a"]
        reason = "links in an archive, which have no bytes of their own: unpack it"
        assert sources.found.left_out == {reason: 2, "files of other kinds": 1}

    def test_a_changed_member_is_done_again(self, folder: Path, tmp_path: Path) -> None:
        archive, files = tmp_path / "a.zip", members(folder)
        write_zip(archive, files)
        run(archive, out=tmp_path / "out")
        listing.open_zip.cache_clear()
        write_zip(archive, files | {"day 0/0.png": files["day 0/2.png"]})
        assert run(archive, out=tmp_path / "out")[1].done == 1

    @pytest.mark.parametrize(("name", "left", "n_whole"), [("a.zip", 500, 0), ("a.tar", 1600, 1), ("a.tar.gz", 400, 1)])
    def test_what_is_cut_off_is_told_and_what_was_before_is_done(
        self, folder: Path, tmp_path: Path, name: str, left: int, n_whole: int
    ) -> None:
        if name == "a.zip":
            archive = write_zip(tmp_path / name, members(folder))
        else:
            archive = write_tar(tmp_path / name, members(folder), "w" if name == "a.tar" else "w:gz")
        archive.write_bytes(archive.read_bytes()[:left])
        sources = Sources((str(archive),))
        assert n_whole <= len(list(sources.inputs())) < 4
        assert "cannot be read to its end" in sources.found.failures[0]
        assert run(archive, out=tmp_path / "out")[1].done == n_whole

    @pytest.mark.parametrize("ending", ["gz", "bz2", "xz"])
    def test_headers_of_a_small_archive_do_not_fill_the_memory(self, tmp_path: Path, ending: str) -> None:
        info = tarfile.TarInfo("a.png")
        info.pax_headers = {"comment": " " * (1 << 24)}
        with tarfile.open(tmp_path / f"a.tar.{ending}", f"w:{ending}", format=tarfile.PAX_FORMAT) as archive:
            archive.addfile(info)
        sources = Sources((str(tmp_path / f"a.tar.{ending}"),))
        assert list(sources.inputs()) == []
        assert "a header is too long" in sources.found.failures[0]

    def test_members_of_a_small_archive_do_not_fill_the_memory(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(listing, "MAX_HELD", 5000)
        files = {f"{i}.png": bytes(2000) for i in range(9)}
        for path, n_first in (
            (write_tar(tmp_path / "a.tgz", files, "w:gz"), 3),
            (write_tar(tmp_path / "a.tar", files), 9),
        ):
            inputs = Sources((str(path),)).inputs()
            first, all_known = listing.begin(inputs, 64)
            assert (len(first), all_known) == (n_first, n_first == 9)
            assert len(first) + len(list(inputs)) == 9
        assert listing.begin(iter(first), 9) == (first, False)

    @pytest.mark.parametrize("ending", ["tar", "tar.gz"])
    def test_members_of_a_tar_file_are_not_counted_first(self, folder: Path, tmp_path: Path, ending: str) -> None:
        archive = write_tar(tmp_path / f"a.{ending}", members(folder), "w:gz" if ending.endswith("gz") else "w")
        with pytest.raises(InputError, match="the members of a tar file are not counted first"):
            Sources((str(folder), str(archive))).count()


class TestStores:
    @pytest.fixture
    def store(self, folder: Path) -> str:
        store = fsspec.filesystem("memory")
        store.store.clear()
        for name, content in members(folder).items():
            store.pipe(f"/bucket/in/{name}", content)
        store.pipe("/bucket/in/notes.txt", b"1")
        return "memory://bucket/in"

    def test_prefixes_globs_and_photos(self, store: str, folder: Path, tmp_path: Path) -> None:
        expected = {f"{store}/{name}": name.removesuffix(".png") for name in members(folder)}
        assert found(store) == expected
        assert found(f"{store}/day 0/*.png") == {f"{store}/day 0/{i}.png": str(i) for i in (0, 2)}
        assert found(f"{store}/**/3.png") == {f"{store}/day 1/3.png": "day 1/3"}
        assert found(f"{store}/day 1/3.png") == {f"{store}/day 1/3.png": "3"}
        assert run(store, out=tmp_path / "out")[1].done == 4
        assert run(store, out=tmp_path / "out")[1].before == 4
        fsspec.filesystem("memory").pipe("/bucket/in/day 0/0.png", members(folder)["day 0/2.png"])
        assert run(store, out=tmp_path / "out")[1].done == 1  # its time and its size are others

    def test_lists_and_archives_in_it(self, store: str, folder: Path, tmp_path: Path) -> None:
        system = fsspec.filesystem("memory")
        system.pipe("/bucket/in/list.txt", b"day 0/0.png\nday 1/1.png\n")
        assert found(f"{store}/list.txt") == {f"{store}/day {i}/{i}.png": f"day {i}/{i}" for i in (0, 1)}
        system.pipe("/bucket/a.zip", write_zip(tmp_path / "a.zip", members(folder)).read_bytes())
        assert run("memory://bucket/a.zip", out=tmp_path / "out")[1].done == 4

    def test_what_is_written_is_no_input(self, store: str) -> None:
        assert found("memory://bucket", out="memory://bucket/in") == {}
        with pytest.raises(InputError, match="depth maps would be taken for photos"):
            Sources((store,), out="memory://bucket")

    def test_nothing_there(self, store: str) -> None:
        sources = Sources(("memory://bucket/none", f"{store}/*.jpg"))
        assert list(sources.inputs()) == []
        assert len(sources.found.failures) == 2
