"""The parts that all published data sets share. Each set is a small class that knows its folder and its unit."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32
from torch.utils.data import Dataset

from zoedepth.data.fit import lies_across, says_how_it_lies
from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.images import ImageArray, read_image_with_orientation
from zoedepth.stored import read_text

MAX_LIST = 1 << 26
"""Bytes of a list, at most: 64 MiB."""


@dataclass(frozen=True)
class About:
    """The facts of a published data set, for people and for checking a download."""

    title: str
    page: str
    """The official page, where to get it."""
    licence: str
    kind: Target
    """The kind of its samples' target."""
    domain: str
    """Scene type of all its photos: "indoor", "outdoor", or "" for stage 1 sets of both."""
    layout: str
    """The folder after download, in a few lines; shown to someone whose folder looks different."""
    unit: str
    """How depth is stored and which values are invalid, in words."""
    splits: Mapping[str, int | None]
    """Name of each split → number of its pairs in a complete download; None where nobody has
    published it."""
    sparse: bool = False
    """True where depth is known at scattered points, as from lidar: differences between neighbours mean nothing."""


@dataclass(frozen=True)
class PairFiles:
    """The files of a photo and its depth."""

    image: Path
    target: Path | None
    """None where the set's own list says that there is none."""
    masks: tuple[Path, ...] = ()
    """Files that say where the target is valid."""
    camera: Path | None = None
    """The file of the intrinsics, where each photo or scene has one."""
    lens: Lens | None = None
    """The focal length that the set's own list has for the photo."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the pair."""
        return tuple(path for path in (self.image, self.target, *self.masks, self.camera) if path is not None)


class PublishedDataset(Dataset[Sample], ABC):
    """A published data set in its official folder, each pair as a ``Sample`` at the size of its depth.

    A subclass says which pairs there are (``list_pairs``) and what a file means (``read_target``). Cropping, resizing
    and the ranges of an evaluation are not its business.

    Args:
        root: its folder, as ``about.layout`` shows it.
        split: one of ``about.splits``.
        allow_missing: accept pairs without truth, and pairs whose files are missing; ``missing_files`` lists those.
        keep_missing: accept pairs whose files are missing.
        use_masks: False ignores the set's own masks of where depth is valid, as the released evaluation does on DIODE.
            It changes nothing for the other sets.

    Raises:
        InputError: there is no such split, the folder is not as expected, or files are missing; the message says which.
    """

    about: ClassVar[About]

    def __init__(
        self,
        root: str | Path,
        *,
        split: str = "train",
        allow_missing: bool = False,
        keep_missing: bool = False,
        use_masks: bool = True,
    ) -> None:
        self.root = Path(root)
        self.use_masks = use_masks
        if split not in self.about.splits:
            raise InputError(
                f"{self.about.title} has no split {split!r}; it has {list(self.about.splits)}: choose one of them"
            )
        self.split = split
        if not self.root.is_dir():
            raise InputError(self.explain(f"{self.root} is not a folder"))
        self.pairs = list(self.list_pairs())
        if not self.pairs:
            raise InputError(self.explain(f"{self.root} has no photos of the split {split!r}"))
        if not (allow_missing or keep_missing) and (missing := self.missing_files()):
            text = f"{len(missing)} files that belong to its {len(self.pairs)} photos are missing, the first is "
            raise InputError(self.explain(text + str(missing[0])))
        if not allow_missing:
            self.pairs = [pair for pair in self.pairs if pair.target is not None]

    @abstractmethod
    def list_pairs(self) -> Sequence[PairFiles]:
        """List the pairs of ``self.split`` under ``self.root``, sorted or in the order of the set's own list.

        Raises:
            InputError: a list or folder is missing (``explain`` makes the message).
        """

    @abstractmethod
    def read_target(
        self, pair: PairFiles
    ) -> tuple[Float32[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
        """Return (metres or disparity, where it is known) for a pair with a target. Unknown values may be anything."""

    def read_photo(self, pair: PairFiles) -> ImageArray:
        """Read the photo of a pair.

        Raises:
            InputError: it is missing or damaged, or EXIF turns it upside down, and perhaps not its target.
        """
        photo, orientation = read_image_with_orientation(pair.image)
        if not says_how_it_lies(photo.shape[:2], orientation):
            raise InputError(
                f"{pair.image} is turned upright by its EXIF orientation {orientation}, and nothing says whether "
                f"{pair.target} is, too. Save it without the orientation, so that both lie alike"
            )
        return photo

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        """Return the camera of a pair's photo at the photo's ``size`` (height, width); None where it is not known."""
        return None

    @property
    def licence(self) -> str:
        """The licence of the data, as its publisher states it."""
        return self.about.licence

    def domain_of(self, pair: PairFiles) -> str:
        """Return the scene type of a pair."""
        return self.about.domain

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> Sample:
        """Read one pair; a photo larger or smaller than its target is resized to it.

        Raises:
            InputError: a file is missing or damaged, or photo and target do not lie alike.
        """
        pair = self.pairs[index]
        photo = self.read_photo(pair)
        size = (photo.shape[0], photo.shape[1])
        if pair.target is None:
            target, known = np.zeros(size, np.float32), np.zeros(size, bool)
        else:
            target, known = self.read_target(pair)
        camera = self.read_camera(pair, size)
        pixels = torch.tensor(photo).permute(2, 0, 1).float() / 255
        if target.shape != size:
            if lies_across(size, target.shape):
                raise InputError(
                    f"{pair.image} is {size} and {pair.target} is {target.shape} (height, width): one of them lies on "
                    "its side, perhaps because EXIF turns the photo. Get the original files"
                )
            pixels = F.interpolate(pixels[None], target.shape, mode="bilinear", antialias=True)[0].clamp(0, 1)
            camera = camera and camera.scaled(target.shape[0] / size[0], target.shape[1] / size[1])
        return Sample(
            image=pixels,
            target=torch.from_numpy(np.where(known, target, 0).astype(np.float32))[None],
            mask=torch.from_numpy(np.ascontiguousarray(known))[None],
            kind=self.about.kind,
            domain=self.domain_of(pair),
            name=self.name_of(index),
            camera=camera,
        )

    def name_of(self, index: int) -> str:
        """Return the name of a sample: its photo's path below the root."""
        return self.pairs[index].image.relative_to(self.root).as_posix()

    @property
    def domains(self) -> list[str]:
        """The scene types that occur."""
        return sorted({self.domain_of(pair) for pair in self.pairs})

    @property
    def kinds(self) -> list[Target]:
        """The kind of target, in a list."""
        return [self.about.kind]

    def missing_files(self) -> list[Path]:
        """List the files of all pairs that do not exist."""
        return [path for pair in self.pairs for path in pair.files if not path.is_file()]

    def find(self, pattern: str) -> list[Path]:
        """Find the files and folders under the root that match a glob pattern, sorted.

        Raises:
            InputError: there are none.
        """
        if not (found := sorted(self.root.glob(pattern))):
            raise InputError(self.explain(f"there is no {pattern} in {self.root}"))
        return found

    def lines(self, name: str, *, origin: str, files: Sequence[str] = ()) -> list[list[str]]:
        """Read the words of each line of a list in the root; empty lines are left out.

        Args:
            name: its file name.
            origin: where to get the list, for the error.
            files: the files that a line names at least, for the error.

        Raises:
            InputError: the list is missing, empty or not text, or a line names too few files.
        """
        path = self.root / name
        try:
            text = read_text(path, max_bytes=MAX_LIST)
        except InputError as error:
            raise InputError(self.explain(f"cannot read the list {path} (get it {origin}): {error}")) from error
        rows = []
        for number, line in enumerate(text.splitlines(), start=1):
            if not (words := line.split()):
                continue
            if len(words) < len(files):
                wanted = f"{', '.join(files[:-1])} and {files[-1]}"
                raise InputError(self.explain(f"line {number} of {name} must name {wanted}: get it anew {origin}"))
            rows.append(words)
        if not rows:
            raise InputError(self.explain(f"the list {path} is empty: get it anew {origin}"))
        return rows

    def inside(self, name: str) -> Path:
        """Return the path under the root that a list names; a leading slash, which some lists have, is ignored.

        Raises:
            InputError: the path leads out of the root.
        """
        if ".." in Path(name).parts:
            raise InputError(f"the path {name!r} of a list leads out of {self.root}: correct the list")
        return self.root / name.lstrip("/")

    def explain(self, problem: str) -> str:
        """Return an error message: what is wrong, what the folder should look like, and where to get the data."""
        layout = "\n".join(f"    {line}" for line in self.about.layout.strip().splitlines())
        return f"{self.about.title}: {problem}. Expected:\n{layout}\nGet it at {self.about.page}"
