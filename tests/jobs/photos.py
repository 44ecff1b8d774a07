"""Tiny photos, and a predictor without a network, for tests of jobs."""

from collections.abc import Callable
from pathlib import Path

from tests.folders import write_photo
from tests.test_batch import Brightness

from zoedepth.batch import Request
from zoedepth.jobs.inputs import Sources
from zoedepth.jobs.manifest import Entry, Manifest, numbered_lines, parse_line
from zoedepth.jobs.place import job_place
from zoedepth.jobs.run import Tally, run_job
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.work import Done

__all__ = ["REQUEST", "Brightness", "contents", "entries", "run", "write_photo", "write_photos"]

REQUEST = Request("brightness", ("npy", "depth"))


def write_photos(folder: Path, n: int = 4) -> Path:
    for index in range(n):
        write_photo(folder / f"day {index % 2}" / f"{index}.png", size=(5 + index % 3, 8), seed=index)
    return folder


def run(
    *sources: object,
    out: object,
    request: Request = REQUEST,
    predictor: Brightness | None = None,
    shard: str = "0/1",
    overwrite: bool = False,
    settings: dict[str, object] | None = None,
    column: str | None = None,
    workers: int = 1,
    known: bool = False,
    at: Callable[[Done], None] = lambda done: None,
) -> tuple[list[Done], Tally]:
    """Do a job as the command line does, without its model, and return the results that were not there before."""
    part, tally = JobShard.parse(shard), Tally()
    listing = Sources(tuple(map(str, sources)), column, part, str(out))
    place = job_place(str(out), part)
    results = []
    with place.opened() as manifest:
        manifest.begin(settings or {"weights": "1"}, named=listing.named, overwrite=overwrite)
        listing.known = manifest.knows if known else None
        for done in run_job(
            listing.inputs(), predictor or Brightness(), request,
            manifest=manifest, destination=place.destination, workers=workers, tally=tally, overwrite=overwrite,
        ):  # fmt: skip
            results.append(done)
            at(done)
    return results, tally


def entries(manifest: Path) -> list[Entry]:
    """Return the entries of a manifest, without the lines of commands."""
    lines = (parse_line(line) for _, line in numbered_lines(manifest))
    return [entry for entry in lines if isinstance(entry, Entry)]


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files below a folder, but for manifests and locks; of sidecars without their seconds."""
    found = {}
    for file in sorted(folder.rglob("*")):
        if file.is_file() and "zoedepth-manifest" not in file.as_posix():
            content = file.read_bytes()
            if file.suffix == ".json":
                content = b"\n".join(line for line in content.splitlines() if b'"seconds"' not in line)
            found[file.relative_to(folder).as_posix()] = content
    return found


def manifest_of(folder: Path, name: str = "zoedepth-manifest.jsonl") -> Manifest:
    return Manifest(folder / name)
