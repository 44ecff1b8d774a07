"""Samples and tar files for the tests of shards."""

import io
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch.utils.data import Dataset

from zoedepth.data.sample import Sample
from zoedepth.shards.dataset import ShardDataset
from zoedepth.shards.writer import ShardSize, write_shards

THREE = ShardSize(samples=3)


class Listed(Dataset[Sample]):
    """Samples that are nowhere in files."""

    def __init__(self, samples: list[Sample]) -> None:
        self.samples = samples

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Sample:
        return self.samples[index]


def sample(target: list[list[float]], **changes: object) -> Sample:
    """A grey photo with these depths, known where they are not 0."""
    depth = torch.tensor(target)[None]
    grey = torch.full((3, *depth.shape[1:]), 128 / 255)
    return replace(Sample(grey, depth, depth > 0, "depth", "indoor", "made"), **changes)


def same(one: Sample, other: Sample) -> bool:
    """Bit for bit."""
    tensors = ((one.image, other.image), (one.target, other.target), (one.mask, other.mask))
    facts = [(s.kind, s.domain, s.name, s.camera) for s in (one, other)]
    return all(torch.equal(a, b) for a, b in tensors) and facts[0] == facts[1]


def there_and_back(folder: Path, samples: list[Sample]) -> list[Sample]:
    write_shards(Listed(samples), folder, name="data", size=THREE)
    dataset = ShardDataset(folder)
    return [dataset[i] for i in range(len(dataset))]


def tar_of(path: Path, members: dict[str, bytes], **options: str) -> Path:
    """A tar file as other programs write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, **{"mode": "w", **options}) as archive:
        for name, content in members.items():
            header = tarfile.TarInfo(name)
            header.size, header.mtime = len(content), 1_700_000_000
            archive.addfile(header, io.BytesIO(content))
    return path


def png(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


PHOTO = png(np.full((1, 2, 3), 128, np.uint8))
DEPTH = png(np.array([[500, 2000]], np.uint16))
ABOUT = b'{"depth_scale": 1000, "domain": "indoor", "name": "a photo"}'
MEMBERS = {"0.png": PHOTO, "0.depth.png": DEPTH, "0.json": ABOUT}
