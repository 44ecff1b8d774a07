"""Which pixels a protocol scores: counts by hand from the published fractions and indices."""

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Crop, crop_mask, protocol_of


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        # Absolute indices, whatever the size: 426 x 560 pixels of NYU.
        ((480, 640), (45, 471), (41, 601)),
        ((768, 1024), (45, 471), (41, 601)),
        ((64, 96), (45, 64), (41, 96)),
        ((40, 40), (0, 0), (0, 0)),
    ],
)
def test_eigen_crop_is_the_same_window_of_every_picture(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    assert_scored(crop_mask(size, "eigen"), size, rows, columns)


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        # 0.40810811 x 352 = 143.65, 0.99189189 x 352 = 349.15, 0.03594771 x 1216 = 43.71, 0.96405229 x 1216 = 1172.29.
        ((352, 1216), (143, 349), (43, 1172)),
        # 153.04, 371.96; 44.65, 1197.35
        ((375, 1242), (153, 371), (44, 1197)),
        # 195.89, 476.11; 23.01, 616.99
        ((480, 640), (195, 476), (23, 616)),
    ],
)
def test_garg_crop_is_the_same_share_of_every_picture(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    assert_scored(crop_mask(size, "garg"), size, rows, columns)


def assert_scored(mask: np.ndarray, size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]) -> None:
    """The mask is True in rows[0] <= row < rows[1] and likewise columns, and nowhere else."""
    assert mask.shape == size
    assert mask.dtype == bool
    assert mask.sum() == (rows[1] - rows[0]) * (columns[1] - columns[0])
    assert mask[rows[0] : rows[1], columns[0] : columns[1]].all()


@pytest.mark.parametrize(
    ("crop", "size", "n_pixels"),
    [("eigen", (480, 640), 426 * 560), ("garg", (352, 1216), 232_574), ("none", (352, 1216), 352 * 1216)],
)
def test_number_of_scored_pixels_is_the_known_one(crop: Crop, size: tuple[int, int], n_pixels: int) -> None:
    assert crop_mask(size, crop).sum() == n_pixels


def test_domains_have_the_protocols_of_nyu_and_kitti() -> None:
    indoor, outdoor = protocol_of("indoor"), protocol_of("outdoor")
    assert (indoor, outdoor) == (INDOOR, OUTDOOR)
    assert (indoor.min_depth, indoor.max_depth, indoor.crop, indoor.kitti_crop) == (1e-3, 10.0, "eigen", False)
    assert (outdoor.min_depth, outdoor.max_depth, outdoor.crop, outdoor.kitti_crop) == (1e-3, 80.0, "garg", True)
    assert indoor.flip_average
    assert outdoor.flip_average


def test_domain_without_protocol_is_an_error_that_names_it_and_the_known() -> None:
    with pytest.raises(InputError, match=r"'attic'.*indoor.*outdoor"):
        protocol_of("attic")
