from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets.blendedmvs import BlendedMVS
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 6)
TRAIN, VAL = "5c1f33f1d33e1f2e4aa6dda4", "5b7a3890fc8fcf6781e2593a"
CAMERA = """extrinsic
0.994 -0.049 0.091 -0.614
0.064 0.984 -0.163 1.301
-0.082 0.168 0.982 0.274
0.0 0.0 0.0 1.0

intrinsic
571.5 0.0 381.25
0.0 572.5 288.75
0.0 0.0 1.0

2.29 0.034 128 6.73
"""


def write_pfm(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    head = f"Pf\n{values.shape[1]} {values.shape[0]}\n-1.000000\n".encode()
    path.write_bytes(head + np.ascontiguousarray(values[::-1], "<f4").tobytes())


def write_scene(root: Path, scene: str, depth: float) -> None:
    """Rows from the top: unknown, infinite, ``depth``, twice that."""
    stored = np.array([[0], [np.inf], [depth], [2 * depth]], np.float32).repeat(SIZE[1], axis=1)
    for frame in ("00000000", "00000012"):
        write_photo(root / scene / f"blended_images/{frame}.jpg", SIZE)
        write_photo(root / scene / f"blended_images/{frame}_masked.jpg", SIZE)
        write_pfm(root / scene / f"rendered_depth_maps/{frame}.pfm", stored)
        (root / scene / "cams").mkdir(exist_ok=True)
        (root / scene / f"cams/{frame}_cam.txt").write_text(CAMERA)
    (root / scene / "cams/pair.txt").write_text("2\n0\n1 1 0.5\n1\n1 0 0.5\n")


class TestTrain(DatasetTester):
    name = "blendedmvs"
    scene, nearer = TRAIN, 0.25

    def write(self, root: Path) -> None:
        write_scene(root, TRAIN, 4)
        write_scene(root, VAL, 2)
        (root / "BlendedMVS_training.txt").write_text(f"{TRAIN}\n")
        (root / "validation_list.txt").write_bytes(f"{VAL}\r\n".encode())

    def check_first(self, sample: Sample) -> None:
        assert sample.name == f"{self.scene}/blended_images/00000000.jpg"
        assert not sample.mask[0, :2].any()
        assert (sample.target[0, 2] == self.nearer).all()
        assert (sample.target[0, 3] == self.nearer / 2).all()
        assert sample.camera == Intrinsics(571.5, 572.5, 381.25, 288.75)


class TestVal(TestTrain):
    split = "val"
    scene, nearer = VAL, 0.5


def test_an_older_list_will_do(tmp_path: Path):
    TestTrain().write(tmp_path)
    (tmp_path / "BlendedMVS_training.txt").rename(tmp_path / "training_list.txt")
    assert len(BlendedMVS(tmp_path)) == 2


def test_nothing_is_known_of_an_empty_map(tmp_path: Path):
    TestTrain().write(tmp_path)
    write_pfm(tmp_path / TRAIN / "rendered_depth_maps/00000000.pfm", np.zeros(SIZE, np.float32))
    assert not BlendedMVS(tmp_path)[0].mask.any()


def test_a_scene_of_the_list_that_is_not_there_is_an_error(tmp_path: Path):
    TestTrain().write(tmp_path)
    (tmp_path / "BlendedMVS_training.txt").write_text(f"{TRAIN}\n5bfe5ae0fe0ea555e6a969ca\n")
    with pytest.raises(InputError, match="there is no 5bfe5ae0fe0ea555e6a969ca/"):
        BlendedMVS(tmp_path)


@pytest.mark.parametrize("text", ["", "extrinsic 1 0 0", "intrinsic\n571.5 0 381.25", "intrinsic\n1 2 3 x 5 6 7 8 9"])
def test_a_damaged_camera_is_an_error(tmp_path: Path, text: str):
    TestTrain().write(tmp_path)
    dataset = BlendedMVS(tmp_path)
    (tmp_path / TRAIN / "cams/00000000_cam.txt").write_text(text)
    with pytest.raises(InputError, match=r"cams/00000000_cam\.txt is not a camera file"):
        dataset[0]
