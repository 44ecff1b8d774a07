"""The benchmark command: its options arrive, its table can be read by people and programs, and its choice is kept."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from rich.console import Console

import zoedepth.runtimes.benchmark
from zoedepth.cli import main
from zoedepth.commands import benchmark as command
from zoedepth.errors import InputError
from zoedepth.runtimes.benchmark import Benchmark
from zoedepth.runtimes.choice import Choice, Row, read_choice
from zoedepth.runtimes.machine import Machine

MACHINE = Machine("A processor", "0f", 2, None)
ROWS = (
    Row("torch, float32", 0.25, 0.2, 0.3, 7.5, 612.0, None, 4.5, 0.0),
    Row("OpenVINO, float32", 0.125, 0.1, 0.2, 15.25, None, None, 3.0, 1.2e-6, file="model.xml"),
    Row("OpenVINO, int8", problem="not installed: pip install 'zoedepth[openvino]'"),
    Row("torch, float16, GPU", 0.01, 0.01, 0.02, 99.0, 900.0, 1200.0, 9.0, 0.02, doubt="calibrated on the same photos"),
)
CHOICE = Choice("OpenVINO, float32", "fastest", "00ff", MACHINE, {"zoedepth": "1"}, "2026-01-31", rows=ROWS)
RESULT = Benchmark(ROWS, CHOICE, (Path("a.jpg"), Path("b.jpg")), (Path("c.jpg"),), 0.005)


@pytest.fixture(autouse=True)
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Nothing is measured; what was asked for is kept, and "result" is the answer, or the error."""
    about: dict[str, Any] = {"result": RESULT}

    def measure(model: str, **options: Any) -> Benchmark:
        about.update(options, model=model)
        options["tell"]("One photo at a time, 1 of [2]")
        if isinstance(about["result"], BaseException):
            raise about["result"]
        return about["result"]

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(zoedepth.runtimes.benchmark, "benchmark", measure)
    return about


def test_plain_lines_where_nobody_looks(asked: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark"]) == 0
    said = capsys.readouterr()
    heading, *rows = said.out.splitlines()
    assert re.split("  +", heading) == [
        "runtime", "s a photo", "least - most", "photos a s", "peak MB", "first depth s", "REL",
    ]  # fmt: skip
    assert rows[0].split() == ["torch,", "float32", "0.250", "0.200", "-", "0.300", "7.50", "612", "4.5", "0.0e+00"]
    assert rows[1].split() == ["OpenVINO,", "float32", "0.125", "0.100", "-", "0.200", "15.25", "?", "3.0", "1.2e-06"]
    assert rows[2] == "OpenVINO, int8       not installed: pip install 'zoedepth[openvino]'"
    assert "  900 + 1200 GPU  " in rows[3]
    assert rows[3].endswith("2.0e-02  calibrated on the same photos")
    assert {rows[0].index("0.0e+00"), rows[3].index("2.0e-02")} == {heading.index("REL") - 4}
    assert rows[4] == (
        "A processor, 2 cores. REL: the largest of 2 photos, against torch in float32; chosen up to 0.5% (1% with 8 "
        "photos: --photos)."
    )
    assert rows[5] == "Chosen: OpenVINO, float32, 15.25 photos a second, REL 1.2e-06."
    assert rows[6] == "To use it: zoedepth predict PHOTOS --out FOLDER --fast"
    assert said.err == "One photo at a time, 1 of [2]\n"
    assert (asked["model"], asked["photos"], asked["repeats"], asked["flip_average"]) == ("zoed-lite", [], 7, True)
    assert (asked["int8"], asked["device"], asked["at_once"], asked["compat"]) == (True, "auto", None, ())
    assert read_choice("00ff", MACHINE, {"zoedepth": "1"}) == CHOICE


def test_table_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(
        command, "Console", lambda **options: Console(**options, force_terminal=True, width=40, color_system="standard")
    )
    assert main(["benchmark", "other.safetensors"]) == 0
    said = capsys.readouterr().out
    assert "\x1b[1;32mOpenVINO, float32 " in said
    assert "zoedepth[openvino]" in said
    assert "--fast --model other.safetensors" in said


def test_options_arrive(tmp_path: Path, asked: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "photos").mkdir()
    for name in ("a.png", "b.jpg"):
        Image.new("RGB", (4, 4)).save(tmp_path / "photos" / name)
    (tmp_path / "photos/notes.txt").touch()
    options = ["--photos", str(tmp_path / "photos"), "--repeats", "3", "--no-flip", "--no-int8", "--device", "cpu"]
    assert main(["benchmark", "m.pt", *options, "--workers", "5", "--compat", "squeeze"]) == 0
    assert [photo.name for photo in asked["photos"]] == ["a.png", "b.jpg"]
    assert (asked["model"], asked["repeats"], asked["flip_average"], asked["int8"]) == ("m.pt", 3, False, False)
    assert (asked["device"], asked["at_once"], asked["compat"]) == ("cpu", 5, ("squeeze",))
    assert "--fast --model m.pt --device cpu --compat squeeze\n" in capsys.readouterr().out


def test_json_has_everything_and_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "new" / "table.json"
    for _ in range(2):
        assert main(["benchmark", "--json", str(path)]) == 0
    said = json.loads(path.read_text())
    assert (said["model"], said["runtime"], said["machine"]["cores"]) == ("zoed-lite", "OpenVINO, float32", 2)
    assert (said["compared_on"], said["calibrated_on"]) == (["a.jpg", "b.jpg"], ["c.jpg"])
    assert [row["runtime"] for row in said["rows"]] == [row.runtime for row in ROWS]
    assert said["rows"][0]["photos_a_second"] == 7.5


def test_runtime_that_fails_has_an_exit_code(asked: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    failed = Row("OpenVINO, int8", problem="the processor is on fire", failed=True)
    asked["result"] = replace(RESULT, rows=(*ROWS[:2], failed))
    assert main(["benchmark"]) == 1
    assert "the processor is on fire" in capsys.readouterr().out


@pytest.mark.parametrize(("error", "code"), [(InputError("no such model"), 2), (KeyboardInterrupt(), 130)])
def test_nothing_is_written_where_nothing_was_measured(
    error: BaseException, code: int, asked: dict[str, Any], tmp_path: Path
) -> None:
    asked["result"] = error
    assert main(["benchmark", "--json", str(tmp_path / "table.json")]) == code
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--repeats", "0"], "--repeats must be 1 or more"),
        (["--workers", "0"], "--workers must be 1 or more"),
        (["--photos", "empty"], "--photos empty holds no photos"),
        (["--json", "mine.json"], "mine.json is not a file of zoedepth benchmark"),
        (["--json", "empty"], "empty is not a file of zoedepth benchmark"),
        (["--json", "mine.json/table.json"], "--json: cannot write to mine.json"),
    ],
)
def test_wrong_options_are_said_before_anything_is_measured(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    asked: dict[str, Any],
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "mine.json").write_text('{"a": 1}')
    assert main(["benchmark", *options]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert "model" not in asked
    assert (tmp_path / "mine.json").read_text() == '{"a": 1}'
