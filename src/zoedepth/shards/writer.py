"""Write samples as shards: the samples stay the same bit for bit, and each shard is written whole or not at all."""

import hashlib
import re
import tarfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import UInt16
from PIL import Image
from torch.utils.data import DataLoader, Dataset

from zoedepth.data.fit import says_how_it_lies
from zoedepth.data.lists import Pair
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample, Samples, Target
from zoedepth.datasets.published import PublishedDataset
from zoedepth.download import sha256_of
from zoedepth.errors import InputError
from zoedepth.images import (
    IMAGE_SUFFIXES,
    PNG_MAX,
    PNG_SCALE_KITTI,
    PNG_SCALE_MILLIMETRE,
    DepthArray,
    atomic_path,
    read_image_with_orientation,
)
from zoedepth.shards.index import INDEX_FILE, Index, Shard, read_index
from zoedepth.shards.members import MAX_SAMPLE, pack
from zoedepth.stored import Memory, to_json

SCALES = (PNG_SCALE_MILLIMETRE, PNG_SCALE_KITTI, 5000.0, 100.0, 1.0)
"""Stored values of one metre that are tried, to store depth as whole numbers; 5000 is TUM's."""

MOST_SKIPPED = 1000
"""Samples that are left out at most, before it is the data as a whole that cannot be read."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}")
_UNITS = {"KB": 10**3, "MB": 10**6, "GB": 10**9}


@dataclass(frozen=True)
class ShardSize:
    """The size at which a shard is full; None does not limit it."""

    bytes: int | None = None
    samples: int | None = None

    @classmethod
    def parse(cls, text: str) -> "ShardSize":
        """Parse "500MB" (KB, MB, GB), or "1000", which is a number of samples.

        Raises:
            InputError: the text is neither.
        """
        found = re.fullmatch(r"(\d{1,12})\s*([KMG]B)?", text.strip().upper())
        if not found or int(found[1]) == 0:
            raise InputError(f"give the size of a shard as 500MB, 2GB, or a number of samples; it is {text!r}")
        number = int(found[1])
        return cls(bytes=number * _UNITS[found[2]]) if found[2] else cls(samples=number)

    def holds(self, n_bytes: int, n_samples: int) -> bool:
        """Return True if a shard may be as large."""
        return (self.bytes is None or n_bytes <= self.bytes) and (self.samples is None or n_samples <= self.samples)


class Packed(NamedTuple):
    """A sample as bytes."""

    block: bytes
    domain: str
    kind: Target
    state: str = ""
    """Text that changes with the size or the time of its files; "" where it has none."""


def write_shards(
    dataset: Samples,
    out: Path,
    *,
    name: str,
    size: ShardSize,
    workers: int = 0,
    track: Callable[[Iterable[Packed | InputError], int], Iterable[Packed | InputError]] = lambda samples, _: samples,
    on_failure: Callable[[int, InputError], None] | None = None,
) -> Index:
    """Write ``out/NAME-000000.tar`` and so on, and ``out/index.json``. Finished shards are not written again.

    A photo keeps the bytes of its file where the data set shows the file as it is; else it becomes a PNG. Depth becomes
    a PNG where that loses nothing, else an .npz of floats. The same samples give the same bytes.

    Args:
        dataset: the samples.
        out: folder for the shards; made if need be.
        name: the beginning of the shards' names: letters, digits, - and _.
        size: how large a shard may become; a shard always takes one sample, however large.
        workers: processes that read and pack; 0 takes this one.
        track: gets the samples and the number of the first one to write, gives them on, and shows progress.
        on_failure: gets the number of a sample that is damaged or larger than 256 MiB, and why. It is left out
            (``Index.skipped``), and tried again only where a shard before it is written again. None: it is an error.

    Raises:
        InputError: a sample cannot be packed, where nobody takes failures, or none can, or more than ``MOST_SKIPPED``
            cannot; or the folder has other shards, or files have changed since they were packed. Finished shards stay,
            and the same call goes on from there.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} cannot be the name of shards: take letters, digits, - and _")
    if not len(dataset):
        raise InputError("there are no samples to write: the data set is empty")
    packing = _Packing(dataset)
    settings = {"name": name, "shard_size": [size.bytes, size.samples], "samples": len(dataset)}
    index = replace(_begun(out, settings, packing), licence=getattr(dataset, "licence", None))
    numbers = _numbers(index, len(dataset))
    first = numbers[-1] + 1 if numbers else 0
    skipped = [number for number in index.skipped if number < first]
    rest = DataLoader(packing, sampler=range(first, len(dataset)), batch_size=None, num_workers=workers)
    samples = _sound(track(rest, first), first, skipped, on_failure)
    packed = next(samples, None)
    while packed is not None:
        path = out / f"{name}-{len(index.shards):06d}.tar"
        with atomic_path(path) as temporary:
            shard, written, packed = _write_shard(temporary, path.name, packed, samples, size)
        index = replace(
            index,
            shards=[*index.shards, shard],
            domains=sorted({*index.domains, *(domain for domain, _ in written)}),
            kinds=sorted({*index.kinds, *(kind for _, kind in written)}),
            skipped=tuple(skipped),
        )
        _write_index(out, index)
    if not index.shards:
        raise InputError(f"none of the {len(dataset)} samples can be read: there is nothing to write")
    if not index.complete or index.skipped != tuple(skipped):
        index = replace(index, complete=True, skipped=tuple(skipped))
        _write_index(out, index)
    return index


def whole_numbers(target: DepthArray, scale: float) -> UInt16[np.ndarray, "height width"] | None:
    """Return the 16-bit levels with which a target is exactly ``levels / scale``; None where there are none."""
    with np.errstate(over="ignore", invalid="ignore"):
        levels = np.rint(target * np.float32(scale))
        exact = np.array_equal(levels / np.float32(scale), target)
    return levels.astype(np.uint16) if exact and levels.min() >= 0 and levels.max() <= PNG_MAX else None


class _Packing(Dataset[Packed | InputError]):
    """Samples by number, as bytes. Errors are returned as values: raised in a worker they would lose their message."""

    def __init__(self, dataset: Samples) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Packed | InputError:
        try:
            state = self.state(index)  # before it is read: what changes meanwhile is found out next time
            sample = self.dataset[index]
            photo, scale = _origin(self.dataset, index)
            block = pack(f"{index:08d}", _pack_photo(sample, photo) | _pack_target(sample, scale))
            if len(block) > MAX_SAMPLE:
                raise InputError(f"{sample.name} has {len(block):,} bytes, more than {MAX_SAMPLE:,}")
        except InputError as error:
            return error
        return Packed(block, sample.domain, sample.kind, state)

    def state(self, index: int) -> str:
        """Return ``Packed.state`` of a sample."""
        if not isinstance(self.dataset, PairDataset | PublishedDataset):
            return ""
        found = []
        for file in self.dataset.pairs[index].files:
            try:
                found.append((file.name, file.stat().st_size, file.stat().st_mtime_ns))
            except OSError:
                found.append((file.name, 0, 0))
        pair = self.dataset.pairs[index]
        said = (pair.kind, pair.scale, pair.domain, pair.camera, pair.max_depth) if isinstance(pair, Pair) else ()
        return repr([*found, *said])


def _origin(dataset: Samples, index: int) -> tuple[Path | None, float | None]:
    """Return (file of the photo, the stored value of one metre); None where there is none."""
    if isinstance(dataset, PairDataset):
        return dataset.pairs[index].image, dataset.pairs[index].scale
    return (dataset.pairs[index].image if isinstance(dataset, PublishedDataset) else None), None


def _pack_photo(sample: Sample, path: Path | None) -> dict[str, bytes]:
    if path is not None and path.suffix.lower() in IMAGE_SUFFIXES:
        content = path.read_bytes()
        # Some data sets crop or resize the photo of the file.
        photo, orientation = read_image_with_orientation(Memory(content, str(path)))
        shown = torch.tensor(photo).permute(2, 0, 1).float() / 255
        # Where it is not seen how depth lies that belongs to a turned photo, the photo is stored upright.
        if torch.equal(shown, sample.image) and says_how_it_lies(photo.shape[:2], orientation):
            suffix = path.suffix.lower().removeprefix(".")
            return {"jpg" if suffix == "jpeg" else suffix: content}
    pixels = (sample.image * 255).round().clamp(0, 255).byte().permute(1, 2, 0)
    return {"png": _png(pixels.numpy())}


def _pack_target(sample: Sample, scale: float | None) -> dict[str, bytes]:
    """Pack the target, mask and JSON of a sample."""
    known = sample.mask[0].numpy()
    target = np.where(known, sample.target[0].numpy(), np.float32(0))
    about: dict[str, object] = {"kind": sample.kind, "domain": sample.domain, "name": sample.name}
    if (camera := sample.camera) is not None:
        about |= {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    members = {}
    for unit in (1.0,) if sample.kind == "disparity" else (scale or SCALES[0], *SCALES):
        if (levels := whole_numbers(target, unit)) is not None:
            members[f"{sample.kind}.png"] = _png(levels)
            about |= {"depth_scale": unit} if sample.kind == "depth" else {}
            break
    else:
        members[f"{sample.kind}.npz"] = _npz(target)
    if not np.array_equal(known, target > 0):
        members["mask.png"] = _png(known.astype(np.uint8) * 255)
    return members | {"json": to_json(dict(sorted(about.items()))).encode()}


def _png(values: np.ndarray) -> bytes:
    file = BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


def _npz(target: DepthArray) -> bytes:
    """Pack floats, of 16 bits where that loses nothing."""
    with np.errstate(over="ignore"):
        half = target.astype(np.float16)
    file = BytesIO()
    np.savez_compressed(file, depth=half if np.array_equal(half.astype(np.float32), target) else target)
    return file.getvalue()


def _sound(
    samples: Iterable[Packed | InputError],
    first: int,
    skipped: list[int],
    on_failure: Callable[[int, InputError], None] | None,
) -> Iterator[Packed]:
    """Yield the samples that are none of the errors; the numbers of the others are added to ``skipped``."""
    for number, sample in enumerate(samples, first):
        if not isinstance(sample, InputError):
            yield sample
        elif on_failure is None or len(skipped) >= MOST_SKIPPED:
            raise sample
        else:
            skipped.append(number)
            on_failure(number, sample)


def _numbers(index: Index, n_samples: int) -> list[int]:
    """Return the number, in the data, of each sample that is in the shards."""
    skipped = set(index.skipped)
    sound = (number for number in range(n_samples) if number not in skipped)
    return list(islice(sound, sum(map(len, index.shards))))


def _write_shard(
    path: Path, name: str, packed: Packed, samples: Iterator[Packed], size: ShardSize
) -> tuple[Shard, set[tuple[str, Target]], Packed | None]:
    """Write a shard; returns it, the (domain, kind) of its samples, and the sample for which it had no room."""
    offsets, written, digest, states = [0], set(), hashlib.sha256(), []
    following: Packed | None = packed
    with path.open("wb") as file:
        while following is not None:
            if len(offsets) > 1 and not size.holds(offsets[-1] + len(following.block), len(offsets)):
                break
            file.write(following.block)
            digest.update(following.block)
            offsets.append(offsets[-1] + len(following.block))
            written.add((following.domain, following.kind))
            states.append(following.state)
            following = next(samples, None)
        end = b"\0" * (2 * tarfile.BLOCKSIZE)  # the mark at the end of a tar file
        file.write(end)
        digest.update(end)
    shard = Shard(name, np.array(offsets, np.int64), digest.hexdigest(), _joined(states))
    return shard, written, following


def _joined(states: Sequence[str]) -> str | None:
    """Return the ``state`` of a shard with samples of these states."""
    return hashlib.sha256("\n".join(states).encode()).hexdigest()[:16] if any(states) else None


def _begun(out: Path, settings: dict[str, object], packing: _Packing) -> Index:
    """Return the index of the shards that are finished in the folder.

    Raises:
        InputError: they are shards of other samples or of another size, or of samples whose files have changed since.
    """
    path = out / INDEX_FILE
    if not path.is_file():
        return Index([], [], [], complete=False, settings=settings)
    index = read_index(path)
    finished = []
    for shard in index.shards:
        file = out / shard.name
        if not file.is_file() or file.stat().st_size < shard.offsets[-1]:
            break
        if shard.sha256 is not None and sha256_of(file) != shard.sha256:
            raise InputError(f"{file} is damaged, or was changed: remove it, and it is written again")
        finished.append(shard)
    numbers = _numbers(replace(index, shards=finished), len(packing))
    same = index.settings == settings and len(numbers) == sum(map(len, finished))
    if same and finished:
        first = packing[numbers[0]]
        if isinstance(first, InputError):
            raise first
        with (out / finished[0].name).open("rb") as file:
            same = file.read(int(finished[0].offsets[1])) == first.block
    if not same:
        raise InputError(f"{out} has shards of other samples or of another size: give another folder, or remove it")
    begin = 0
    for shard in finished:
        packed = numbers[begin : begin + len(shard)]
        state = _joined([packing.state(number) for number in packed])
        if shard.state and state != shard.state:
            raise InputError(
                f"files of samples {packed[0]} to {packed[-1]}, or what is said of them, have changed since "
                f"{out / shard.name} was written: remove it, and it is written again, or give another folder"
            )
        begin += len(shard)
    return replace(index, shards=finished, complete=index.complete and len(finished) == len(index.shards))


def _write_index(out: Path, index: Index) -> None:
    with atomic_path(out / INDEX_FILE) as temporary:
        temporary.write_text(index.to_json(), encoding="utf-8")
