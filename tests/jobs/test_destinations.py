"""Where files go: each gets its name when it is whole, and nothing of others is replaced."""

import errno
from pathlib import Path

import pytest
from tests.jobs.photos import contents, run, write_photos

from zoedepth.jobs.destinations import LocalFolder


class TestFolder:
    def test_it_has_files_of_their_sizes(self, tmp_path: Path) -> None:
        (tmp_path / "a.npy").write_bytes(b"12345")
        folder = LocalFolder(tmp_path, "m")
        assert folder.has({"npy": ("a.npy", 5)})
        assert not folder.has({"npy": ("a.npy", 4)})
        assert not folder.has({"npy": ("a.npy", 5), "depth": ("b.png", 1)})
        assert folder.where("a.npy") == str(tmp_path / "a.npy")

    def test_another_disk_within_the_tree(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        replace = Path.replace

        def across(self: Path, target: Path) -> Path:
            if ".zoedepth-drafts" in str(self) and ".zoedepth-drafts" not in str(target):
                raise OSError(errno.EXDEV, "Invalid cross-device link")
            return replace(self, target)

        photos = write_photos(tmp_path / "in", 2)
        run(photos, out=tmp_path / "expected")
        monkeypatch.setattr(Path, "replace", across)
        assert run(photos, out=tmp_path / "out")[1].done == 2
        assert contents(tmp_path / "out") == contents(tmp_path / "expected")

    @pytest.mark.parametrize(
        "plan", ["", "{", '{"place": "../..", "files": ["a.npy"]}', '{"place": "/", "files": ["a"]}']
    )
    def test_drafts_of_somebody_else_s_making_go_nowhere(self, tmp_path: Path, plan: str) -> None:
        drafts = tmp_path / "out" / ".zoedepth-drafts-m" / "x"
        drafts.mkdir(parents=True)
        (drafts / "a.npy").touch()
        (drafts / "place").write_text(plan)
        LocalFolder(tmp_path / "out", "m").mend()
        assert list((tmp_path / "out").iterdir()) == []
        assert [path.name for path in tmp_path.iterdir()] == ["out"]
