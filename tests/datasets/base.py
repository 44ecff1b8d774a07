"""What every published data set must do; a data set's test class writes its folder and says what is in it."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
from PIL import Image

from zoedepth.data.sample import Sample
from zoedepth.datasets import DATASETS
from zoedepth.datasets.published import PublishedDataset
from zoedepth.errors import InputError


class DatasetTester(ABC):
    """Inherit, name the data set, and write a folder of it in exactly the official layout and encoding."""

    name: ClassVar[str]
    """Key of ``DATASETS``."""
    split: ClassVar[str] = "train"
    n_frames: ClassVar[int] = 2
    """Pairs with truth that ``write`` writes for the split."""

    @abstractmethod
    def write(self, root: Path) -> None:
        """Write a small data set under ``root`` (an existing, empty folder)."""

    @abstractmethod
    def check_first(self, sample: Sample) -> None:
        """Compare the first sample with what was written: values, mask, camera."""

    @pytest.fixture
    def root(self, tmp_path: Path) -> Path:
        self.write(tmp_path)
        return tmp_path

    def open(self, root: Path, **arguments: bool) -> PublishedDataset:
        return DATASETS[self.name](root, split=self.split, **arguments)

    def test_has_the_pairs_that_were_written(self, root: Path):
        assert len(self.open(root)) == self.n_frames

    def test_first_sample_is_what_was_written(self, root: Path):
        self.check_first(self.open(root)[0])

    def test_every_sample_is_well_formed(self, root: Path):
        dataset = self.open(root)
        for index in range(len(dataset)):
            sample = dataset[index]
            assert sample.image.dtype == torch.float32
            assert sample.image.shape[0] == 3
            assert sample.image.min() >= 0
            assert sample.image.max() <= 1
            assert sample.target.dtype == torch.float32
            assert sample.mask.dtype == torch.bool
            assert sample.target.shape == sample.mask.shape == (1, *sample.image.shape[1:])
            assert sample.mask.any()
            assert sample.target.isfinite().all()
            assert (sample.target[~sample.mask] == 0).all()
            assert sample.kind == dataset.about.kind
            assert dataset.licence == dataset.about.licence
            if sample.kind == "depth":
                assert (sample.target[sample.mask] > 0).all()
            assert sample.domain in dataset.domains
            assert (root / sample.name).is_file()

    def test_order_and_values_are_the_same_every_time(self, root: Path):
        first, second = self.open(root), self.open(root)
        assert [frame.image for frame in first.pairs] == [frame.image for frame in second.pairs]
        a, b = first[len(first) - 1], second[len(second) - 1]
        assert torch.equal(a.image, b.image)
        assert torch.equal(a.target, b.target)
        assert torch.equal(a.mask, b.mask)

    def test_facts_are_complete(self):
        about = DATASETS[self.name].about
        assert about.title
        assert about.licence
        assert about.unit
        assert about.layout.strip()
        assert about.page.startswith("https://")
        assert self.split in about.splits

    def test_unknown_split_is_an_error_that_lists_the_splits(self, root: Path):
        with pytest.raises(InputError, match=r"no split 'holiday'; it has"):
            DATASETS[self.name](root, split="holiday")

    def test_missing_folder_is_an_error_with_layout_and_page(self, tmp_path: Path):
        with pytest.raises(InputError, match="is not a folder") as caught:
            self.open(tmp_path / "nowhere")
        about = DATASETS[self.name].about
        assert about.page in str(caught.value)
        assert about.layout.strip().splitlines()[0].strip() in str(caught.value)

    def test_wrong_folder_is_an_error_that_says_what_is_not_there(self, tmp_path: Path):
        (tmp_path / "holiday.jpg").write_bytes(b"")
        with pytest.raises(InputError, match=DATASETS[self.name].about.page):
            self.open(tmp_path)

    def test_missing_depth_is_an_error_that_names_the_file_unless_allowed(self, root: Path):
        target = self.open(root).pairs[0].target
        assert target is not None
        target.unlink()
        with pytest.raises(InputError, match="1 files that belong to") as caught:
            self.open(root)
        assert str(target) in str(caught.value)
        assert self.open(root, allow_missing=True).missing_files() == [target]

    def test_damaged_depth_is_an_error_that_names_the_file(self, root: Path):
        dataset = self.open(root)
        target = dataset.pairs[0].target
        assert target is not None
        target.write_bytes(b"\x89PNG\r\n\x1a\n not one")
        with pytest.raises(InputError) as caught:
            dataset[0]
        assert str(target) in str(caught.value)


def write_photo(path: Path, size: tuple[int, int], *, color: tuple[int, int, int] = (200, 100, 50)) -> None:
    """A photo of one colour, (height, width)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (size[1], size[0]), color).save(path)


def write_png(path: Path, values: np.ndarray) -> None:
    """A PNG of one channel of the array's 8 or 16 bits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(values).save(path)


def slope(size: tuple[int, int], low: float, high: float) -> np.ndarray:
    """From low at the left to high at the right, float32 (height, width)."""
    return np.broadcast_to(np.linspace(low, high, size[1], dtype=np.float32), size).copy()
