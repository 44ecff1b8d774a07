"""A job as a whole: what its shards have done, and one manifest made of theirs."""

import re
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.jobs.manifest import NAME, Entry, Manifest, begin_line, manifest_name, only_command
from zoedepth.jobs.origins import is_address, open_store, patiently
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.store import Store
from zoedepth.jobs.stored_manifest import StoredManifest
from zoedepth.lock import HeldError, lock_file

_FILE = re.compile(rf"{NAME}(?:-(\d+)-of-(\d+))?(\.jsonl)?")


@dataclass(frozen=True)
class ShardStatus:
    """A shard of a job, or a whole job that has none, as far as its manifest tells."""

    shard: JobShard
    done: int
    """Inputs that are done."""
    failed: int
    """Inputs that have failed, and were not done since."""
    by: str
    """The process that worked on it last."""
    began: str
    """The time at which that began, UTC."""
    fingerprint: str
    """Hash of its settings."""
    running: bool | None
    """True if a command works on it now; None where nobody can know: in a store, or where its lock cannot be asked."""


def find_manifests(out: str) -> dict[JobShard, str]:
    """Return shard → name of its manifest, of a job's folder or prefix.

    Raises:
        InputError: there is none, or no such folder.
    """
    if is_address(out):
        store, root = open_store(out)
        try:
            names = [
                str(name).rstrip("/").rpartition("/")[2] for name in patiently(lambda: store.ls(root, detail=False))
            ]
        except FileNotFoundError as error:
            raise InputError(f"there is nothing at {out}: check the address") from error
    else:
        if not Path(out).is_dir():
            raise InputError(f"{out} is no folder: give the --out of a job")
        names = [path.name for path in Path(out).iterdir()]
    found = {}
    for match in filter(None, map(_FILE.fullmatch, names)):
        if match[3] is None and not is_address(out):  # a store's, copied to a folder: it is a folder of parts
            continue
        shard = JobShard() if match[1] is None else JobShard(int(match[1]), int(match[2]))
        found[shard] = manifest_name(shard)
    if not found:
        raise InputError(f"{out} has no {NAME}.jsonl: it is not the --out of a job")
    return dict(sorted(found.items(), key=lambda pair: (pair[0].count, pair[0].index)))


def read_status(out: str) -> list[ShardStatus]:
    """Return what each shard of a job has done.

    Raises:
        InputError: ``out`` is not the folder or the prefix of a job.
    """
    found = []
    for shard, name in find_manifests(out).items():
        with _opened(out, name) as manifest:
            last = manifest.runs[-1] if manifest.runs else {}
            running = None if is_address(out) else _is_running(Path(out, name))
            found.append(
                ShardStatus(
                    shard, manifest.n_done, manifest.n_failed, str(last.get("by", "")), str(last.get("began", "")),
                    manifest.counted or manifest.fingerprint, running,
                )
            )  # fmt: skip
    return found


def read_failures(out: str) -> Iterator[Entry]:
    """Yield the entries of inputs that have failed, and were not done since.

    Raises:
        InputError: ``out`` is not the folder or the prefix of a job.
    """
    for name in find_manifests(out).values():
        with _opened(out, name) as manifest:
            yield from (entry for entry in manifest.current() if entry.status != "done")


def missing_shards(status: list[ShardStatus]) -> list[JobShard]:
    """Return the shards of which there is no manifest: nobody has begun them, or theirs is elsewhere."""
    found = {each.shard for each in status}
    counts = sorted({each.shard.count for each in status})
    return [shard for count in counts for i in range(count) if (shard := JobShard(i, count)) not in found]


_FILES_EACH, _FILES_BESIDE = 4, 100
"""Files that are open for each shard while they are merged (its lock, manifest and database), and others."""


def _allow_files(n: int) -> None:
    """Raise the number of files that this process may have open, where the system lets it: 1024 are usual."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows has no such limit
        return
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = n if most == resource.RLIM_INFINITY else min(n, most)
    if now != resource.RLIM_INFINITY and now < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def merge_shards(out: str) -> int:
    """Put the manifests of all shards into one, so that a command without ``--shard`` goes on where they were.

    The one that there is already is part of it. The manifests of the shards are removed when the one is written.

    Returns:
        The number of inputs that are done.

    Raises:
        InputError: there are no shards, a command works on one of them, they have different settings, or the job is in
            a store.
    """
    if is_address(out):
        raise InputError(
            f"{out}: manifests are merged in folders, and not in stores. Go on there with the same number of shards"
        )
    folder, names = Path(out), list(find_manifests(out).values())
    whole = manifest_name(JobShard())
    if names == [whole]:
        raise InputError(f"{out} has one manifest, {whole}, and no shards to merge")
    _allow_files(_FILES_EACH * len(names) + _FILES_BESIDE)
    with ExitStack() as stack:
        for name in {*names, whole}:
            stack.enter_context(only_command(folder / name))
        manifests = [stack.enter_context(_opened(out, name)) for name in names]
        jobs = {manifest.counted for manifest in manifests if manifest.counted is not None}
        # Where photos were only named one by one, as by a shell's *.jpg, there is no job, and all commands must agree.
        jobs = jobs or {manifest.fingerprint for manifest in manifests}
        if len(jobs) > 1:
            raise InputError(
                f"the shards in {out} have different settings ({', '.join(sorted(jobs))}), so that they are not of one "
                "job: do them again with the same options and --overwrite"
            )
        # The file that was written to last comes last, and has the last word: its outputs have replaced the others'.
        manifests.sort(key=lambda manifest: manifest.path.stat().st_mtime_ns)
        (job,) = jobs
        settings = next(run["settings"] for each in manifests for run in each.runs if run["fingerprint"] == job)
        with atomic_path(folder / whole) as temporary, temporary.open("wb") as file:
            file.write(begin_line(settings, fingerprint=job, named=False))
            # Failures first: a success of another shard's, from before it was a shard, wins.
            for status in ("failed", "done"):
                for manifest in manifests:
                    file.writelines(entry.to_line() for entry in manifest.current(job) if entry.status == status)
        for name in names:
            if name != whole:
                (folder / name).unlink()
                lock_file(folder / name).unlink(missing_ok=True)
        with _opened(out, whole) as manifest:
            return manifest.n_done


@contextmanager
def _opened(out: str, name: str) -> Iterator[Manifest]:
    with closing(
        StoredManifest(Store(out.rstrip("/")), name) if is_address(out) else Manifest(Path(out, name))
    ) as found:
        yield found


def _is_running(manifest: Path) -> bool | None:
    if not lock_file(manifest).exists():
        return False
    try:
        with only_command(manifest):
            return False
    except HeldError:
        return True
    except InputError:  # the lock cannot be asked, e.g. in a folder of somebody else
        return None
