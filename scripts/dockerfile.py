"""Run the steps of the Dockerfile one by one in a fresh folder, without Docker, and try what comes out.

    python scripts/dockerfile.py [--whole]

Paths of the image lie below a temporary folder. Torch, which has gigabytes, is taken from the environment that runs
this, with all that is installed there; --whole installs everything as Docker would. The service must pass its health
check, answer a photo, write no file, and end by SIGTERM.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path
from urllib.request import Request, urlopen

ROOT = Path(__file__).parent.parent
IMAGE_PATHS = ("/opt/zoedepth", "/src")
"""Folders that the image has beside those of its base."""
_NETWORK = ("_proxy", "_cert", "_bundle")  # endings of variables that pip needs to reach its index
PHOTO = ROOT / "src/zoedepth/serve/page/examples/room.jpg"


def instructions(text: str) -> list[tuple[str, str]]:
    """Return the instructions of a Dockerfile, e.g. ("RUN", "pip install .")."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    joined = re.sub(r"\\\n", " ", "\n".join(lines))
    return [(line.split(maxsplit=1)[0].upper(), line.split(maxsplit=1)[1].strip()) for line in joined.splitlines()]


class Build:
    """The image as it is built, below a folder."""

    def __init__(self, root: Path, *, whole: bool) -> None:
        self.root, self.whole = root, whole
        self.environment = {"PATH": os.environ["PATH"]}
        self.workdir = root
        self.user: tuple[int, int] | None = None
        self.health: list[str] = []
        self.entry: list[str] = []

    def here(self, text: str) -> str:
        """Return a text with the paths of the image below the folder."""
        for path in IMAGE_PATHS:
            text = re.sub(rf"(?<![\w/.]){path}(?=[/:'\"\s]|$)", f"{self.root}{path}", text)
        return text

    def step(self, name: str, rest: str) -> None:
        """Do what one instruction says."""
        print(f"{name} {rest}", flush=True)
        if name == "FROM":
            self.environment = {"PATH": os.environ["PATH"]}
        elif name == "ARG":
            key, _, value = rest.partition("=")
            self.environment[key] = value
        elif name == "ENV":
            for pair in shlex.split(rest):
                key, _, value = pair.partition("=")
                self.environment[key] = self.here(value).replace("$PATH", self.environment["PATH"])
        elif name == "WORKDIR":
            self.workdir = Path(self.here(rest))
            self.workdir.mkdir(parents=True)
        elif name == "COPY":
            self._copy(shlex.split(rest))
        elif name == "RUN":
            self._run(rest)
        elif name == "USER":
            user, _, group = rest.partition(":")
            self.user = int(user), int(group)
        elif name == "HEALTHCHECK":
            self.health = json.loads(rest.partition(" CMD ")[2])
        elif name == "ENTRYPOINT":
            self.entry = json.loads(rest)
        elif name not in ("EXPOSE", "STOPSIGNAL"):
            raise SystemExit(f"{name} is not known here")

    def _copy(self, words: list[str]) -> None:
        if words[0].startswith("--from="):  # all stages share the folder
            if not Path(self.here(words[1])).exists() or words[1] != words[2]:
                raise SystemExit(f"{words[1]} is not there, or goes to another place")
            return
        *sources, target = words
        for source in sources:
            place = self.workdir / target / ("" if (ROOT / source).is_dir() else source)
            copy = shutil.copytree if (ROOT / source).is_dir() else shutil.copy
            copy(ROOT / source, place)

    def _run(self, command: str) -> None:
        if "$TORCH_INDEX" in command and not self.whole:
            (packages,) = self.root.glob("opt/zoedepth/lib/python*/site-packages")
            (packages / "installed.pth").write_text(sysconfig.get_path("purelib") + "\n")
            print("  torch and all else is taken from here")
            return
        network = {name: value for name, value in os.environ.items() if name.lower().endswith(_NETWORK)}
        subprocess.run(
            self.here(command), shell=True, check=True, cwd=self.workdir, env=network | self.environment,
            stdout=subprocess.DEVNULL,
        )  # fmt: skip


def try_out(build: Build, port: int) -> None:
    """Start the entry point as its user, and use it."""
    command = [str(port) if word == "8000" else word for word in build.entry]
    program = shutil.which(command[0], path=build.environment["PATH"])
    if program is None or not program.startswith(str(build.root)):
        raise SystemExit(f"{command[0]} is not in the image")
    who = {} if os.getuid() or not _may_run(build) else {"user": build.user[0], "group": build.user[1]}
    whom = f"user {build.user}" if who else "the user that runs this: another one cannot run its Python"
    print(f"{shlex.join(command)}  # as {whom}", flush=True)
    before = _files(build.root)
    process = subprocess.Popen([program, *command[1:]], env=build.environment, cwd=build.root, **who)
    try:
        health = [word.replace("8000", str(port)) for word in build.health]
        for _ in range(120):
            if subprocess.run(health, env=build.environment, stderr=subprocess.DEVNULL, check=False).returncode == 0:
                break
            time.sleep(0.5)
        else:
            raise SystemExit("the health check fails")
        request = Request(f"http://127.0.0.1:{port}/v1/depth", PHOTO.read_bytes(), {"Content-Type": "image/jpeg"})
        with urlopen(request) as answer:
            assert answer.read(8) == b"\x89PNG\r\n\x1a\n"
        with urlopen(f"http://127.0.0.1:{port}/") as page:
            assert b"<html" in page.read()
    finally:
        process.send_signal(signal.SIGTERM)
        code = process.wait(25)
    if code != 143:
        raise SystemExit(f"it ended with {code}, not 143")
    if written := _files(build.root) - before:
        raise SystemExit(f"it wrote {sorted(written)[:5]}")
    print("healthy, answers, writes nothing, ends by SIGTERM")


def _may_run(build: Build) -> bool:
    """Return True if the user of the image can run the Python that the folder's one leads to."""
    python = build.root / "opt/zoedepth/bin/python"
    assert build.user is not None
    done = subprocess.run(
        ["true"], check=False, user=build.user[0], group=build.user[1], cwd=build.root, capture_output=True
    )
    real = python.resolve()
    return done.returncode == 0 and all(parent.stat().st_mode & 0o001 for parent in real.parents)


def _files(folder: Path) -> set[str]:
    return {str(path) for path in folder.rglob("*") if path.is_file()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--whole", action="store_true", help="install torch, too")
    parser.add_argument("--port", type=int, default=8765)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        build = Build(Path(folder), whole=options.whole)
        for name, rest in instructions((ROOT / "Dockerfile").read_text(encoding="utf-8")):
            build.step(name, rest)
        try_out(build, options.port)
    return 0


if __name__ == "__main__":
    sys.exit(main())
