"""The page of the documentation about the service says what is so, and its programs work as they stand."""

import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.pages import blocks
from tests.serve.running import Client, photo

from zoedepth.commands.options import call
from zoedepth.commands.serve import serve
from zoedepth.depth_map import DepthMap
from zoedepth.serve.answers import FORMATS, NAMES
from zoedepth.serve.problems import KINDS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "serve.md").read_text(encoding="utf-8")


def test_every_problem_is_told_with_its_status() -> None:
    rows = re.findall(r"^\| (\d[\d, ]*) \| (`[^|]*) \|", PAGE, flags=re.MULTILINE)
    told = {kind: statuses for statuses, kinds in rows for kind in re.findall(r"`([a-z-]+)`", kinds)}
    assert set(told) == set(KINDS)
    assert all(str(KINDS[kind].status) in statuses.split(", ") for kind, statuses in told.items())


def test_every_format_is_told() -> None:
    paragraph = PAGE[PAGE.index("`?format=` says") : PAGE.index("### Arrays")]
    words = set(re.findall(r"`([a-z]+)`", paragraph))
    assert all({known.name, *known.aliases} & words for known in FORMATS.values())
    assert words <= set(NAMES)


def test_every_option_that_is_told_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        call(serve, ["--help"], prog="zoedepth serve")
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    text = PAGE[PAGE.index("## Limits") : PAGE.index("## Deployment")]
    assert set(re.findall(r"`(--[a-z-]+)", text)) <= known


def test_curl(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # The tiny model is unsure of nearly every pixel's neighbourhood, and the places that the page names are anybody's.
    monkeypatch.setattr(DepthMap, "valid", property(lambda result: np.ones(result.size, bool)))
    Path("photo.jpg").write_bytes(photo(544, 244, format="JPEG"))
    lines = [line for block in blocks(PAGE, "bash") for line in block.splitlines() if line.startswith("curl ")]
    assert len(lines) == 5
    for line in lines:
        words = shlex.split(line)[1:]
        path = next(word for word in words if word.startswith("http")).partition(":8000")[2]
        given = dict(word.split("=", 1) for flag, word in pairwise(words) if flag == "-F")
        parts = {
            name: Path(value[1:]).read_bytes() if value.startswith("@") else value.encode()
            for name, value in given.items()
        }
        if parts:
            answer = client.form(path, parts)
        elif "--data-binary" in words:
            answer = client.ask(path, Path("photo.jpg").read_bytes(), headers={"Content-Type": "image/jpeg"})
        else:
            answer = client.ask(path)
        assert answer.status == 200, (line, answer.body[:300])
        if "-o" in words:
            Path(words[words.index("-o") + 1]).write_bytes(answer.body)
    assert Path("depth.png").read_bytes().startswith(b"\x89PNG")


def test_python(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("requests")
    monkeypatch.chdir(tmp_path)
    Path("photo.jpg").write_bytes(photo(64, 48, format="JPEG"))
    send, make = blocks(PAGE, "python")
    exec(send.replace(":8000", f":{client.port}"), {})
    median, source = capsys.readouterr().out.split()
    assert float(median) > 0
    assert source == "given"
    names: dict[str, object] = {}
    exec(make, names)
    assert callable(names["app"])


def test_pictures_are_there() -> None:
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", PAGE)
    assert [picture for picture in pictures if not (ROOT / "docs" / picture).is_file()] == []
