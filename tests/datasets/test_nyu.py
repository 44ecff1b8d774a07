from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, slope, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.nyu import NYU
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (48, 64)
DEPTH = slope(SIZE, 0.7, 9.9)


def write_scene(folder: Path) -> None:
    for number in (12, 45):
        write_photo(folder / f"rgb_{number:05d}.jpg", SIZE)
        stored = np.rint(DEPTH * 1000).astype(np.uint16)
        stored[:5] = 0
        write_png(folder / f"sync_depth_{number:05d}.png", stored)


class TestTrain(DatasetTester):
    name = "nyu"

    def write(self, root: Path) -> None:
        write_scene(root / "sync/kitchen_0028b")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "sync/kitchen_0028b/rgb_00012.jpg"
        np.testing.assert_allclose(sample.target[0, 5:], DEPTH[5:], atol=5e-4)
        assert not sample.mask[0, :5].any()
        assert sample.mask[0, 5:].all()
        assert sample.domain == "indoor"
        assert sample.camera == Intrinsics(518.8579, 519.4696, 325.5824, 253.7362)


class TestTest(TestTrain):
    split = "test"

    def write(self, root: Path) -> None:
        write_scene(root / "official_splits/test/kitchen")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "official_splits/test/kitchen/rgb_00012.jpg"
        np.testing.assert_allclose(sample.target[0, 5:], DEPTH[5:], atol=5e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"nyudepthv2_train_files_with_gt\.txt is empty: get it anew from github\.com/cleinc/bts"),
        (
            "/a.jpg /a.png 518\n\n<html>\n",
            "line 3 of nyudepthv2_train_files_with_gt.txt must name a photo and its depth",
        ),
    ],
)
def test_a_list_that_is_none_is_an_error_that_names_it(tmp_path: Path, text: str, message: str):
    write_scene(tmp_path / "sync/kitchen_0028b")
    (tmp_path / "nyudepthv2_train_files_with_gt.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        NYU(tmp_path)


@pytest.mark.parametrize("base", ["", "sync"])
def test_a_list_with_leading_slashes_gives_the_order(tmp_path: Path, base: str):
    """As BTS's list has them, relative to sync/ or to the root."""
    write_scene(tmp_path / "sync/kitchen_0028b")
    start = f"/{base}/kitchen_0028b" if base else "/kitchen_0028b"
    rows = [f"{start}/rgb_{n}.jpg {start}/sync_depth_{n}.png 518.8579" for n in ("00045", "00012")]
    (tmp_path / "nyudepthv2_train_files_with_gt.txt").write_text("\n".join(rows) + "\n")
    assert [frame.image.name for frame in NYU(tmp_path).pairs] == ["rgb_00045.jpg", "rgb_00012.jpg"]
