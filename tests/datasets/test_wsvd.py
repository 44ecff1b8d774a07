from pathlib import Path

import numpy as np
from PIL import Image
from tests.datasets.base import DatasetTester, write_png
from tests.datasets.test_movies3d import write_disparity

from zoedepth.data.sample import Sample
from zoedepth.datasets.wsvd import WSVD

SIZE = (4, 6)


def write_wsvd(root: Path) -> None:
    """Frames of 4x6, side by side: the left half is 4x3, its columns red, green, green; the right half is blue.

    Columns of disparity: -2 at the left half, 3 at the right.
    """
    both = np.zeros((*SIZE, 3), np.uint8)
    both[:, 0, 0], both[:, 1:3, 1], both[:, 3:, 2] = 255, 255, 255
    stored = np.repeat(np.array([[0, 500]], np.uint16), 3, axis=1).repeat(SIZE[0], axis=0)
    for name in ("000000", "000024"):
        (root / "aBcD-_12345/frames").mkdir(parents=True, exist_ok=True)
        Image.fromarray(both).save(root / f"aBcD-_12345/frames/{name}.jpg", quality=100, subsampling=0)
        write_disparity(root / f"aBcD-_12345/disparity/{name}.png", stored, offset="-2.0", scale="0.01")


class TestTrain(DatasetTester):
    name = "wsvd"

    def write(self, root: Path) -> None:
        write_wsvd(root)

    def check_first(self, sample: Sample) -> None:
        assert sample.image.shape == (3, *SIZE)
        assert sample.mask.all()
        assert np.allclose(sample.target[0, :, :3], -2)
        assert np.allclose(sample.target[0, :, 3:], 3)
        red, green, blue = sample.image[:, 0]
        assert red[0] > 0.9
        assert (green[3:] > 0.9).all()
        assert (blue < 0.1).all(), "nothing of the right half"


def test_the_photo_is_stretched_to_its_proportions(tmp_path: Path):
    write_wsvd(tmp_path)
    dataset = WSVD(tmp_path)
    assert dataset.read_photo(dataset.pairs[0]).shape == (4, 6, 3)


def test_disparity_may_be_smaller_than_the_photo(tmp_path: Path):
    write_wsvd(tmp_path)
    for path in (tmp_path / "aBcD-_12345/disparity").iterdir():
        write_disparity(path, np.zeros((2, 3), np.uint16), offset="1", scale="1")
    sample = WSVD(tmp_path)[0]
    assert sample.image.shape == (3, 2, 3)
    assert (sample.target == 1).all()


def test_uncertainty_counts_where_there_is_any(tmp_path: Path):
    write_wsvd(tmp_path)
    uncertainty = np.zeros(SIZE, np.uint8)
    uncertainty[1] = 21
    for name in ("000000", "000024"):
        write_png(tmp_path / f"aBcD-_12345/uncertainty/{name}.png", uncertainty)
    assert WSVD(tmp_path)[0].mask[0].all(dim=1).tolist() == [True, False, True, True]
