"""A folder of photos with depth, listed in a CSV file: the format for your own data.

One line a pair, paths relative to the CSV file::

    image,depth,depth_scale,domain
    image/0001.jpg,depth/0001.png,1000,indoor

``depth`` is a 16-bit PNG, metres = value / ``depth_scale``, 0 where unknown. ``disparity`` in its place is an 8- or
16-bit PNG of inverse depth up to an unknown scale and shift, for stage 1, where the domain may be left out. Other
columns are left alone.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from zoedepth.data.readers import read_png
from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.images import read_image


@dataclass(frozen=True)
class Pair:
    """One line of the CSV file."""

    image: Path
    target: Path | None
    """None where the list says that there is none."""
    kind: Target
    scale: float
    """depth: the stored value of one metre. disparity: 1."""
    domain: str


class PairDataset(Dataset[Sample]):
    """The pairs of one CSV file, as :class:`Sample` at their own size.

    Args:
        path: the CSV file, or a folder with one of the name of the split.
        split: name of the CSV file, without suffix, where ``path`` is a folder.
        allow_missing: a depth of "None" in the list is a photo without truth, as in KITTI's test list; otherwise an
            error, for nothing can be learned from it.

    Raises:
        InputError: the CSV file is missing or malformed (the line is named), or files it lists are missing.
    """

    def __init__(self, path: str | Path, *, split: str = "train", allow_missing: bool = False) -> None:
        path = Path(path)
        self.path = path / f"{split}.csv" if path.is_dir() else path
        if not self.path.is_file():
            columns = "image,depth,depth_scale,domain"
            raise InputError(f"there is no {self.path}; give a CSV file with the columns {columns}")
        try:
            with self.path.open(newline="", encoding="utf-8-sig") as file:  # -sig: spreadsheets write a mark first
                rows = list(csv.DictReader(file))
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"{self.path} is not a CSV file in UTF-8 ({error})") from error
        self.pairs = [_parse(row, self.path, line) for line, row in enumerate(rows, start=2)]
        if not self.pairs:
            raise InputError(f"{self.path} lists no pairs")
        if not allow_missing and (bare := [pair.image for pair in self.pairs if pair.target is None]):
            raise InputError(f"{self.path} lists {len(bare)} photos without depth, the first is {bare[0]}")
        paths = [path for pair in self.pairs for path in (pair.image, pair.target) if path is not None]
        missing = [path for path in paths if not path.is_file()]
        if missing:
            raise InputError(f"{self.path} lists {len(missing)} files that do not exist, the first is {missing[0]}")

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> Sample:
        """Read one pair.

        Raises:
            InputError: a file is damaged, or photo and target differ in size.
        """
        pair = self.pairs[index]
        image = read_image(pair.image)
        stored = np.zeros(image.shape[:2], np.uint16) if pair.target is None else read_png(pair.target)
        if stored.shape != image.shape[:2]:
            raise InputError(f"{pair.image} is {image.shape[:2]} and {pair.target} is {stored.shape}: sizes must agree")
        target = torch.from_numpy(stored.astype(np.float32) / pair.scale)[None]
        return Sample(
            image=torch.tensor(image).permute(2, 0, 1).float() / 255,
            target=target,
            mask=target > 0,
            kind=pair.kind,
            domain=pair.domain,
            name=str(pair.image.relative_to(self.path.parent)),
        )

    @property
    def domains(self) -> list[str]:
        """The domains that occur."""
        return sorted({pair.domain for pair in self.pairs})

    @property
    def kinds(self) -> list[Target]:
        """The kinds of target that occur."""
        return sorted({pair.kind for pair in self.pairs})


def _parse(row: dict[str, str], path: Path, line: int) -> Pair:
    """A line of the CSV file."""
    kinds: list[Target] = [kind for kind in ("depth", "disparity") if row.get(kind)]
    if not row.get("image") or len(kinds) != 1:
        raise InputError(f"{path}, line {line}: needs image and one of depth or disparity")
    kind = kinds[0]
    if kind == "depth" and not row.get("domain"):
        raise InputError(f"{path}, line {line}: needs a domain, for example indoor")
    try:
        scale = float(row["depth_scale"]) if kind == "depth" else 1.0
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}, line {line}: depth_scale must be the stored value of one metre") from error
    if not 0 < scale < math.inf:
        raise InputError(f"{path}, line {line}: depth_scale must be finite and > 0; it is {scale}")
    bare = row[kind] == "None"
    for name in (row["image"], row[kind]):
        # A list is data from elsewhere: it may not reach out of its folder.
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(f"{path}, line {line}: {name!r} must be a path inside the folder of the CSV file")
    target = None if bare else path.parent / row[kind]
    return Pair(path.parent / row["image"], target, kind, scale, row.get("domain") or "")
