"""``zoedepth jobs``: it says what there is, and its exit code tells whether something failed."""

import json
from pathlib import Path

import pytest
from tests.jobs.photos import run, write_photo, write_photos

from zoedepth.cli import main


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = write_photos(tmp_path / "in", 9)
    (folder / "bad\t.png").write_bytes(b"no picture")
    for shard in ("0/3", "2/3", "1/3"):
        run(folder, out=tmp_path / "out", shard=shard)
    return tmp_path / "out"


def test_status(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "status", str(out)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[-1] == "together: 9 done, 1 failed"
    assert lines[0].startswith("shard 0/3: ")
    assert ", not running; began 2" in lines[0]
    (out / "zoedepth-manifest-1-of-3.jsonl").unlink()
    main(["jobs", "status", str(out)])
    assert "shard 1/3: nothing yet; nobody has begun it, or" in capsys.readouterr().out


def test_as_json(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "status", str(out), "--json"]) == 1
    lines = list(map(json.loads, capsys.readouterr().out.splitlines()))
    assert [line["shard"] for line in lines] == ["0/3", "1/3", "2/3"]
    assert sum(line["done"] for line in lines) == 9


def test_failed(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "status", str(out), "--failed"]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"{out.parent / 'in' / 'bad'}")
    assert "not an image" in line


def test_failed_as_json(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "status", str(out), "--failed", "--json"]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    values = json.loads(line)
    assert set(values) == {"input", "error"}
    assert values["error"]


def test_a_named_photo_hides_no_failure(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["jobs", "merge", str(out)])
    run(write_photo(out.parent / "x.png"), out=out, settings={"weights": "2"})
    capsys.readouterr()
    assert main(["jobs", "status", str(out)]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "together: 9 done, 1 failed"
    assert main(["jobs", "status", str(out), "--failed"]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_merge(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "merge", str(out)]) == 0
    assert capsys.readouterr().out == f"9 photos are done, 1 failed: zoedepth jobs status {out} --failed\n"
    assert main(["jobs", "status", str(out)]) == 1
    assert capsys.readouterr().out.splitlines()[0].startswith("all: 9 done, 1 failed")


def test_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "status", str(tmp_path)]) == 2
    assert "it is not the --out of a job" in capsys.readouterr().err
    assert main(["jobs", "statsu"]) == 2
    assert "did you mean status" in capsys.readouterr().err
    assert main(["jobs"]) == 2
