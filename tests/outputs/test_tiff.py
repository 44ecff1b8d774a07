"""TIFFs of float32 metres."""

from pathlib import Path

import numpy as np
from PIL import Image

from zoedepth.outputs.tiff import write_tiff


def test_is_a_picture_of_floats_that_says_its_unit(tmp_path: Path) -> None:
    depth = np.array([[0.25, np.nan, 1e-5], [700, -1, np.inf]], np.float32)
    write_tiff(tmp_path / "folder" / "a.tif", depth)
    with Image.open(tmp_path / "folder" / "a.tif") as picture:
        assert (picture.format, picture.mode) == ("TIFF", "F")
        assert "metres" in picture.tag_v2[270]
        np.testing.assert_array_equal(np.asarray(picture), np.float32([[0.25, 0, 1e-5], [700, 0, 0]]))


def test_of_every_size_says_in_its_first_bytes_whose_it_is(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tiff", np.ones((1200, 900), np.float32))
    assert b"made by zoedepth" in (tmp_path / "a.tiff").read_bytes()[:512]
