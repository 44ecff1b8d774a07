"""``zoedepth reproduce``: which options do what, and the tables that are written."""

from pathlib import Path

import pytest
from tests.folders import write_pairs

from zoedepth.cli import main
from zoedepth.reproduction import run
from zoedepth.reproduction.run import Result
from zoedepth.reproduction.units import Unit


@pytest.fixture
def nyu(tmp_path: Path) -> str:
    write_pairs(tmp_path / "nyu", n=2)
    write_pairs(tmp_path / "nyu", n=1, split="test")
    return f"nyu={tmp_path / 'nyu'}"


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Rows and seeds that were run; nothing is trained."""
    found: list[tuple[str, int]] = []

    def run_unit(out: Path, unit: Unit, scored: dict[str, object], **_: object) -> Result:
        assert out.is_absolute()
        assert list(scored) == ["nyu"]
        found.append((unit.row.name, unit.seed))
        return Result({})

    monkeypatch.setattr(run, "run_unit", run_unit)
    return found


BASE = ("--base", "M12=zoed-lite")


def test_rows_are_run_for_every_seed_and_shared_among_commands(
    nyu: str, tmp_path: Path, started: list[tuple[str, int]]
) -> None:
    words = ["reproduce", "log-binomial", "--small", "--data", nyu, "--out", str(tmp_path / "out"), *BASE]
    assert main([*words, "--seeds", "2"]) == 0
    both = [("Softmax", 43), ("Log-binomial", 43), ("Softmax", 44), ("Log-binomial", 44)]
    assert started == both
    started.clear()
    for index in range(3):
        assert main([*words, "--seeds", "2", "--shard", f"{index}/3"]) == 0
    assert started == both
    started.clear()
    assert main([*words, "--only", "Soft"]) == 0
    assert main([*words, "--show"]) == 0
    assert started == [("Softmax", 43)]


def test_table_is_written_and_says_what_has_not_run(
    nyu: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["reproduce", "table-5", "--small", "--show", "--data", nyu, "--out", str(out), *BASE]
    assert main(words) == 0
    files = {path.name for path in out.iterdir() if path.is_file()}
    assert files == {f"table-5-small.{suffix}" for suffix in ("md", "html", "tex")}
    assert main(words) == 0  # its own files are replaced
    text = (out / "table-5-small.md").read_text()
    assert "| Naive head | not run | not run | 0.096 | not run | 0.335 |" in text
    assert "0.096" in capsys.readouterr().out


def test_files_that_are_not_ours_are_never_replaced(
    nyu: str, tmp_path: Path, started: list[tuple[str, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "table-5-small.tex").write_text("mine")
    assert main(["reproduce", "table-5", "--small", "--data", nyu, "--out", str(out), *BASE]) == 2
    assert "table-5-small.tex is not of a reproduction" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["table-5-small.tex"]
    assert started == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("table-7",), "table-5"),
        (("table-5",), "without kitti, relative, scenes: add"),
        (("table-5", "--base", "M13=x"), "M13"),
        (("table-5", "--seeds", "0", *BASE), "--seeds is 0"),
        (("table-5", "--only", "GAN", *BASE), "no row of table-5 has GAN in its name: they are Naive head"),
        (("table-5", "--shard", "3/3", *BASE), "--shard must be i/n"),
    ],
)
def test_what_cannot_be_is_an_error_before_any_work(
    nyu: str,
    tmp_path: Path,
    started: list[tuple[str, int]],
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    message: str,
) -> None:
    assert main(["reproduce", *words, "--small", "--data", nyu, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert started == []


def test_what_is_trained_on_is_not_scored_on(
    nyu: str, tmp_path: Path, started: list[tuple[str, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    one = f"{nyu}/train.csv"
    assert main(["reproduce", "table-5", "--small", *BASE, "--data", one, "--out", str(tmp_path / "out")]) == 2
    assert "would be trained on and scored on the same pairs" in capsys.readouterr().err
    assert started == []
