"""What the published data sets have in common; each of them is a small class that knows its folder and its unit."""

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

from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.images import ImageArray, read_image


@dataclass(frozen=True)
class About:
    """The facts of a published data set, for people and for checking a download."""

    title: str
    page: str
    """Where to get it: the official page."""
    licence: str
    kind: Target
    """What a sample's target is."""
    domain: str
    """Scene type of all its photos: "indoor", "outdoor", or "" for stage 1 sets of both."""
    layout: str
    """The folder after download, a few lines, as shown to someone whose folder is not so."""
    unit: str
    """How depth is stored, what is invalid, in words."""
    splits: Mapping[str, int | None]
    """Name of each split → number of its pairs in a complete download; None where nobody has published it."""
    sparse: bool = False
    """Depth is known at scattered points, as lidar's: neighbours' differences mean nothing."""


@dataclass(frozen=True)
class Frame:
    """The files of one pair."""

    image: Path
    target: Path | None
    """None where the set's own list says that there is none."""
    masks: tuple[Path, ...] = ()
    """Files that say where the target is valid."""
    camera: Path | None = None
    """File of the intrinsics, where each photo or scene has one."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All of them."""
        return tuple(path for path in (self.image, self.target, *self.masks, self.camera) if path is not None)


class PublishedDataset(Dataset[Sample], ABC):
    """A published data set in its official folder, as ``Sample`` at the size of its depth.

    A set says what its frames are (``list_frames``) and what a file means (``read_target``); cropping, resizing and
    evaluation ranges are elsewhere.

    Args:
        root: its folder, as ``about.layout`` shows it.
        split: one of ``about.splits``.
        allow_missing: frames without truth, or whose files are missing, are no error here; ``missing_files`` tells.
        use_masks: False leaves out the set's own masks of where depth is valid, as the released evaluation does on
            DIODE; of the other sets it changes nothing.

    Raises:
        InputError: no such split; the folder is not as expected, or files are missing: what and where is said.
    """

    about: ClassVar[About]

    def __init__(
        self, root: str | Path, *, split: str = "train", allow_missing: bool = False, use_masks: bool = True
    ) -> None:
        self.root = Path(root)
        self.use_masks = use_masks
        if split not in self.about.splits:
            raise InputError(f"{self.about.title} has no split {split!r}; it has {list(self.about.splits)}")
        self.split = split
        if not self.root.is_dir():
            raise InputError(self.explain(f"{self.root} is not a folder"))
        self.frames = list(self.list_frames())
        if not self.frames:
            raise InputError(self.explain(f"{self.root} has no photos of the split {split!r}"))
        if not allow_missing and (missing := self.missing_files()):
            text = f"{len(missing)} files that belong to its {len(self.frames)} photos are missing, the first is "
            raise InputError(self.explain(text + str(missing[0])))
        if not allow_missing:
            self.frames = [frame for frame in self.frames if frame.target is not None]

    @abstractmethod
    def list_frames(self) -> Sequence[Frame]:
        """The frames of ``self.split`` under ``self.root``, sorted or in the order of the set's own list.

        Raises:
            InputError: a list or folder that must be there is not (``explain`` makes the message).
        """

    @abstractmethod
    def read_target(self, frame: Frame) -> tuple[Float32[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
        """(metres or disparity, where it is known) of a frame that has a target. Values elsewhere do not matter."""

    def read_photo(self, frame: Frame) -> ImageArray:
        """The photo of a frame."""
        return read_image(frame.image)

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        """The camera of a frame's photo, at the photo's ``size`` (height, width); None where it is not known."""
        return None

    def domain_of(self, frame: Frame) -> str:
        """Scene type of a frame."""
        return self.about.domain

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        """Read one pair; a photo larger or smaller than its target is resized to it.

        Raises:
            InputError: a file is missing or damaged.
        """
        frame = self.frames[index]
        photo = self.read_photo(frame)
        size = (photo.shape[0], photo.shape[1])
        if frame.target is None:
            target, known = np.zeros(size, np.float32), np.zeros(size, bool)
        else:
            target, known = self.read_target(frame)
        camera = self.read_camera(frame, size)
        pixels = torch.tensor(photo).permute(2, 0, 1).float() / 255
        if target.shape != size:
            pixels = F.interpolate(pixels[None], target.shape, mode="bilinear", antialias=True)[0].clamp(0, 1)
            camera = camera and camera.scaled(target.shape[0] / size[0], target.shape[1] / size[1])
        return Sample(
            image=pixels,
            target=torch.from_numpy(np.where(known, target, 0).astype(np.float32))[None],
            mask=torch.from_numpy(np.ascontiguousarray(known))[None],
            kind=self.about.kind,
            domain=self.domain_of(frame),
            name=frame.image.relative_to(self.root).as_posix(),
            camera=camera,
        )

    @property
    def domains(self) -> list[str]:
        """The scene types that occur."""
        return sorted({self.domain_of(frame) for frame in self.frames})

    @property
    def kinds(self) -> list[Target]:
        """The kinds of target that occur: one."""
        return [self.about.kind]

    def missing_files(self) -> list[Path]:
        """Files of the frames that do not exist."""
        return [path for frame in self.frames for path in frame.files if not path.is_file()]

    def find(self, pattern: str) -> list[Path]:
        """The files and folders under the root that match a glob pattern, sorted.

        Raises:
            InputError: there are none.
        """
        if not (found := sorted(self.root.glob(pattern))):
            raise InputError(self.explain(f"there is no {pattern} in {self.root}"))
        return found

    def lines(self, name: str, *, origin: str) -> list[list[str]]:
        """The words of each line of a list that lies in the root.

        Args:
            name: its file name.
            origin: where such a list comes from, for the error.

        Raises:
            InputError: it is missing, or not text.
        """
        path = self.root / name
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(self.explain(f"cannot read the list {path} ({origin})")) from error
        return [words for line in text.splitlines() if (words := line.split())]

    def inside(self, name: str) -> Path:
        """A path that a list names, under the root; a leading slash is ignored, as lists in circulation have them.

        Raises:
            InputError: it reaches out of the root.
        """
        if ".." in Path(name).parts:
            raise InputError(f"the path {name!r} of a list leads out of {self.root}")
        return self.root / name.lstrip("/")

    def explain(self, problem: str) -> str:
        """An error message: what is wrong, what the folder should look like, and where to get it."""
        layout = "\n".join(f"    {line}" for line in self.about.layout.strip().splitlines())
        return f"{self.about.title}: {problem}. Expected:\n{layout}\nIt is at {self.about.page}"
