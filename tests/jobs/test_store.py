"""Files in a store: each is whole, nothing of others is replaced, and a store that fails is asked again."""

from pathlib import Path, PurePosixPath

import fsspec
import pytest
from tests.jobs.photos import REQUEST, contents, run, write_photo, write_photos

from zoedepth.errors import InputError
from zoedepth.jobs import origins
from zoedepth.jobs.store import Store


class TestStore:
    """The store is fsspec's in memory, which is like S3 in what matters: files are there when they are whole."""

    @pytest.fixture
    def out(self, monkeypatch: pytest.MonkeyPatch) -> str:
        monkeypatch.setattr(origins, "_FIRST_WAIT", 0)
        fsspec.filesystem("memory").store.clear()
        return "memory://bucket/depth"

    def stored(self) -> dict[str, bytes]:
        """Return the files of the job, without manifests."""
        files = fsspec.filesystem("memory").store.items()
        return {name.removeprefix("/bucket/depth/"): file.getvalue() for name, file in files if "manifest" not in name}

    def test_it_gets_what_a_folder_gets(self, tmp_path: Path, out: str) -> None:
        photos = write_photos(tmp_path / "in")
        assert run(photos, out=out, workers=2)[1].done == 4
        run(photos, out=tmp_path / "expected")
        expected = contents(tmp_path / "expected")
        assert self.stored().keys() == expected.keys()
        assert all(content == expected[name] for name, content in self.stored().items() if not name.endswith(".json"))
        assert run(photos, out=out)[1].before == 4
        fsspec.filesystem("memory").rm("/bucket/depth/day 0/2.json")
        assert run(photos, out=out)[1].done == 1

    def test_files_of_others_and_of_another_photo_are_kept(self, tmp_path: Path, out: str) -> None:
        photo = write_photo(tmp_path / "a.png")
        store = fsspec.filesystem("memory")
        store.pipe("/bucket/depth/a.json", b'{"shapes": []}')
        assert "a.json is not from zoedepth" in str(run(photo, out=out)[0][0].entry.error)
        store.rm("/bucket/depth/a.json")
        assert run(photo, out=out)[1].done == 1
        other = write_photo(tmp_path / "other" / "a.png")
        assert "is of" in str(run(other, out=out)[0][0].entry.error)

    def test_files_of_earlier_runs_stay_known(self, tmp_path: Path, out: str) -> None:
        photo = write_photo(tmp_path / "a.png")
        run(photo, out=out)
        results, _ = run(photo, out=out, settings={"weights": "2"}, request=type(REQUEST)("b", ("npz",)))
        assert results[0].sidecar["other_files"] == ["a_depth.npy", "a_depth.png"]

    def test_a_store_that_fails_and_comes_back(self, tmp_path: Path, out: str, monkeypatch: pytest.MonkeyPatch) -> None:
        store = fsspec.filesystem("memory")
        put, left = type(store).put_file, 2

        def failing(self: object, *arguments: object, **options: object) -> None:
            nonlocal left
            left -= 1
            if left >= 0:
                raise ConnectionResetError("reset by peer")
            put(self, *arguments, **options)

        monkeypatch.setattr(type(store), "put_file", failing)
        assert run(write_photos(tmp_path / "in", 2), out=out)[1].done == 2

    def test_a_store_that_is_gone_is_the_end(self, tmp_path: Path, out: str, monkeypatch: pytest.MonkeyPatch) -> None:
        photos = write_photos(tmp_path / "in")
        run(photos / "day 0" / "0.png", out=out)
        before = self.stored()
        store = fsspec.filesystem("memory")

        def gone(*_: object, **__: object) -> None:
            raise TimeoutError("no answer")

        put = type(store).put_file
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                type(store),
                "put_file",
                lambda self, file, path, **o: (gone if "manifest" not in path else put)(self, file, path, **o),
            )
            with pytest.raises(InputError, match="nothing more can be written to memory://bucket/depth"):
                run(photos, out=out)
        assert self.stored() == before
        _, tally = run(photos, out=out)
        assert (tally.done + tally.before, tally.failed) == (4, 0)

    def test_a_store_that_does_not_answer_is_not_taken_for_empty(
        self, out: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def silent(*_: object, **__: object) -> None:
            raise RuntimeError("no answer")

        monkeypatch.setattr(type(fsspec.filesystem("memory")), "info", silent)
        with pytest.raises(InputError, match=f"{out} does not answer .*no answer.* type the same again"):
            Store(out).has({"sidecar": ("day 0/0.json", 1)})

    def test_a_server_of_files_shows_them_when_they_are_whole(self, tmp_path: Path) -> None:
        """Through fsspec's own files of this machine, which are not whole until they are closed."""
        photos = write_photos(tmp_path / "in", 2)
        assert run(photos, out=f"file://{tmp_path}/out")[1].done == 2
        run(photos, out=tmp_path / "expected")
        found = contents(tmp_path / "out")
        assert found.keys() == contents(tmp_path / "expected").keys()
        assert not [name for name in found if name.endswith(".part")]

    def test_a_photo_lies_below_the_prefix(self) -> None:
        store = Store("s3://bucket/depth")
        assert store.photo(Path("a.png"), PurePosixPath("x/a")).file("_depth.png").as_posix() == "x/a_depth.png"
        assert store.where("x/a_depth.png") == "s3://bucket/depth/x/a_depth.png"
