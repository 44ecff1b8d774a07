"""The image's recipe names what is there. ``scripts/dockerfile.py`` runs its steps, which takes minutes."""

import json
import re
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

from zoedepth.commands.options import call
from zoedepth.commands.serve import TOKEN, serve

ROOT = Path(__file__).parent.parent
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def lines(name: str) -> list[str]:
    return re.findall(rf"^{name} (.*)$", DOCKERFILE, flags=re.MULTILINE)


def test_everything_that_is_copied_is_there_and_not_left_out() -> None:
    kept = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    sources = [word for line in lines("COPY") if "--from" not in line for word in line.split()[:-1]]
    assert sources
    for source in sources:
        assert (ROOT / source).exists()
        assert any(fnmatch(source, pattern) for pattern in kept)


def test_the_extras_that_are_installed_exist() -> None:
    (extras,) = re.findall(r"'\.\[(.*)\]'", DOCKERFILE)
    known = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert all(re.search(rf"^{extra} = \[", known, flags=re.MULTILINE) for extra in extras.split(","))


def test_it_is_nobody_and_looks_after_itself(capsys: pytest.CaptureFixture[str]) -> None:
    (user,) = lines("USER")
    assert all(int(number) > 1000 for number in user.split(":"))
    (check,) = lines("HEALTHCHECK")
    program = json.loads(check.partition(" CMD ")[2])
    compile(program[2], "health check", "exec")
    assert "/readyz" in program[2]
    (entry,) = map(json.loads, lines("ENTRYPOINT"))
    assert entry[:2] == ["zoedepth", "serve"]
    with pytest.raises(SystemExit):
        call(serve, [*entry[2:], "--help"], prog="zoedepth serve")
    assert "--host" in capsys.readouterr().out


def test_compose_starts_the_same_image_without_rights() -> None:
    service = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))["services"]["zoedepth"]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["ports"] == ["127.0.0.1:8000:8000"]  # this machine alone
    assert any(TOKEN in variable for variable in service["environment"])
    assert int(service["stop_grace_period"].removesuffix("s")) > 20
