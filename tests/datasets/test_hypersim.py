from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets.hypersim import Hypersim
from zoedepth.errors import InputError

# A picture 3 wide has a focal length of sqrt(6.75). A ray 4.5 pixels above the middle is sqrt(6.75 + 20.25) long there,
# twice as much: the depth at the top of the middle column is half the distance.
SIZE = (10, 3)
COLUMNS = "scene_name,camera_name,frame_id,included_in_public_release,exclude_reason,split_partition_name"
LIST = "metadata_images_split_scene_v1.csv"


def write_frame(root: Path, scene: str, frame: int) -> None:
    images = root / scene / "images"
    write_photo(images / f"scene_cam_00_final_preview/frame.{frame:04d}.tonemap.jpg", SIZE)
    distance = np.full(SIZE, 6, np.float16)
    distance[4] = np.nan
    (images / "scene_cam_00_geometry_hdf5").mkdir(exist_ok=True)
    with h5py.File(images / f"scene_cam_00_geometry_hdf5/frame.{frame:04d}.depth_meters.hdf5", "w") as file:
        file["dataset"] = distance


class TestTest(DatasetTester):
    name = "hypersim"
    split = "test"

    def write(self, root: Path) -> None:
        """Only the frames of one split; the list has those of others and what was not released."""
        rows = [
            "ai_001_001,cam_00,1,True,,train",
            "ai_001_010,cam_00,0,True,,test",
            'ai_001_010,cam_00,1,False,"a logo, twice",',
            "ai_001_010,cam_00,2,False,a person,test",
            "ai_001_010,cam_00,21,True,,test",
            "ai_001_011,cam_00,3,True,,val",
        ]
        (root / LIST).write_text("\n".join([COLUMNS, *rows]) + "\n")
        for scene, frame in {
            "train": [("ai_001_001", 1)],
            "val": [("ai_001_011", 3)],
            "test": [("ai_001_010", 0), ("ai_001_010", 21)],
        }[self.split]:
            write_frame(root, scene, frame)

    def check_first(self, sample: Sample) -> None:
        assert sample.target[0, 0, 1].item() == pytest.approx(3)
        assert sample.target[0, 9, 1].item() == pytest.approx(3)
        # Half a pixel from the middle: 6 / sqrt(1 + 0.25 / 6.75)
        assert sample.target[0, 5, 1].item() == pytest.approx(6 * (27 / 28) ** 0.5)
        assert sample.target[0, 0, 0] < sample.target[0, 0, 1]
        assert not sample.mask[0, 4].any()
        assert sample.mask.sum() == 27
        assert sample.domain == "indoor"
        assert sample.camera is not None
        assert (sample.camera.cx, sample.camera.cy) == (1, 4.5)
        assert sample.camera.fx == sample.camera.fy == pytest.approx(6.75**0.5)


class TestTrain(TestTest):
    split = "train"
    n_frames = 1


class TestVal(TestTest):
    split = "val"
    n_frames = 1


def test_focal_length_of_the_published_size(tmp_path: Path):
    TestTest().write(tmp_path)
    dataset = Hypersim(tmp_path, split="test")
    camera = dataset.read_camera(dataset.pairs[0], (768, 1024))
    assert camera is not None
    assert camera.fx == pytest.approx(886.81, abs=0.001)
    assert (camera.cx, camera.cy) == (511.5, 383.5)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (f"{COLUMNS}\nai_001_010,cam_00,one,True,,test\n", "line 2: needs the columns scene_name"),
        (f"{COLUMNS}\nai_001_010\n", "line 2: needs the columns scene_name"),
        (f"{COLUMNS}\n../../etc,cam_00,0,True,,test\n", "leads out of"),
        (f"{COLUMNS}\n", "no photos of the split 'test'"),
        ("\xff", "cannot read the list"),
    ],
)
def test_a_bad_list_is_an_error(tmp_path: Path, content: str, problem: str):
    (tmp_path / LIST).write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=problem):
        Hypersim(tmp_path, split="test")
