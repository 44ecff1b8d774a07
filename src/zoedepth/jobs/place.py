"""The place of a job: where its files go, and its manifest, held by one command at a time."""

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from zoedepth.errors import InputError
from zoedepth.jobs.destinations import Destination, LocalFolder
from zoedepth.jobs.manifest import Manifest, manifest_name, only_command
from zoedepth.jobs.origins import is_address, open_store, patiently
from zoedepth.jobs.shard import JobShard
from zoedepth.jobs.store import Store
from zoedepth.jobs.stored_manifest import StoredManifest


@dataclass(frozen=True)
class JobPlace:
    """Where a job, or a shard of one, writes to."""

    destination: Destination
    shard: JobShard
    kept: bool = True
    """False keeps no manifest: the files are a stream's, and are gone after."""

    @contextmanager
    def opened(self) -> Iterator[Manifest]:
        """Give the manifest to read and add to, until the block ends.

        Raises:
            InputError: another command works on it, it is no manifest, or nothing can be written there.
        """
        name = manifest_name(self.shard)
        with ExitStack() as stack:
            try:
                if isinstance(self.destination, Store):
                    manifest: Manifest = StoredManifest(self.destination, name)
                elif not self.kept:
                    manifest = Manifest(Path(stack.enter_context(TemporaryDirectory())) / name)
                else:
                    manifest = self._of_folder(stack, name)
            except OSError as error:
                raise InputError(f"--out {self.destination.name} cannot be used ({error.strerror or error})") from error
            try:
                yield manifest
            finally:
                if isinstance(self.destination, LocalFolder):
                    self.destination.tidy()
                manifest.close()

    def _of_folder(self, stack: ExitStack, name: str) -> Manifest:
        assert isinstance(self.destination, LocalFolder)
        folder = self.destination.folder
        folder.mkdir(parents=True, exist_ok=True)
        stack.enter_context(only_command(folder / name))
        whole = folder / manifest_name(JobShard())
        is_part = self.shard.count > 1 and whole.exists()
        manifest = Manifest(folder / name, whole=stack.enter_context(closing(Manifest(whole))) if is_part else None)
        self.destination.mend()
        return manifest


def job_place(out: str | Path, shard: JobShard, *, kept: bool = True) -> JobPlace:
    """Return the place that ``--out`` names, a folder or an address.

    Raises:
        InputError: the address is of no known kind, or its store does not answer.
        MissingExtraError: the library for this kind of store is not installed.
    """
    if not is_address(str(out)):
        return JobPlace(LocalFolder(Path(out), manifest_name(shard).removesuffix(".jsonl")), shard, kept)
    address = str(out).rstrip("/")
    if address.startswith(("http://", "https://")):
        raise InputError(
            f"--out {out}: nothing can be written to an address of the web. Give a folder, or s3://, gs://"
        )
    store, root = open_store(address)
    try:
        fresh = not patiently(lambda: store.exists(root) and bool(store.ls(root, detail=False)))
    except OSError as error:
        raise InputError(f"--out {out} cannot be looked at ({error.strerror or error})") from error
    return JobPlace(Store(address, fresh), shard, kept)
