from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.movies3d import Movies3D
from zoedepth.errors import InputError

SIZE, FRAME = (4, 6), (8, 12)
NAMES = ("exodus/chapter2/out00000005", "exodus/chapter2/out00000011")


def write_disparity(path: Path, stored: np.ndarray, **text: str) -> None:
    """As ``get_disp_and_uncertainty.py`` writes it: 16 bits, the unit in text chunks."""
    info = PngInfo()
    for key, value in text.items():
        info.add_text(key, value)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(stored).save(path, pnginfo=info)


def write_movies(root: Path, name: str = "train", frames: tuple[str, ...] = NAMES) -> None:
    """Rows of disparity: -10, -10, 0, 30 pixels, of which the first is too uncertain."""
    stored = np.array([[0], [0], [200], [800]], np.uint16).repeat(SIZE[1], axis=1)
    uncertainty = np.array([[21], [20], [0], [0]], np.uint8).repeat(SIZE[1], axis=1)
    for frame in frames:
        write_photo(root / f"image_left/{frame}.jpg", FRAME)
        write_disparity(root / f"disparity/{frame}.png", stored, offset="-10.0", scale="0.05")
        write_png(root / f"uncertainty/{frame}.png", uncertainty)
    (root / "lists").mkdir(exist_ok=True)
    (root / f"lists/{name}.txt").write_text("\n".join(frames) + "\n")


class TestTrain(DatasetTester):
    name = "movies3d"
    list_name = "train"

    def write(self, root: Path) -> None:
        write_movies(root, self.list_name)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "image_left/exodus/chapter2/out00000005.jpg"
        assert sample.image.shape == (3, *SIZE), "photos are twice as large as disparity"
        assert not sample.mask[0, 0].any()
        assert sample.mask[0, 1:].all()
        assert np.allclose(sample.target[0, 1:, 0], [-10, 0, 30])
        assert sample.camera is None


class TestVal(TestTrain):
    split, list_name = "val", "validation"


class TestTest(TestTrain):
    split, list_name = "test", "test"


@pytest.mark.parametrize("size", [SIZE, FRAME])
def test_sky_has_the_least_known_disparity_and_is_known(tmp_path: Path, size: tuple[int, int]):
    write_movies(tmp_path)
    sky = np.zeros(size, np.uint8)
    sky[: size[0] // 4, : size[1] // 2] = 255  # half of the first row, which is uncertain
    sky[-(size[0] // 4) :, : size[1] // 2] = 255  # and of the last, wrongly near
    for name in NAMES:
        write_png(tmp_path / f"sky/{name}.png", sky)
    sample = Movies3D(tmp_path)[0]
    assert sample.mask[0, 0].tolist() == 3 * [True] + 3 * [False]
    assert (sample.target[0, 0, :3] == -10).all()
    assert np.allclose(sample.target[0, 3], 3 * [-10] + 3 * [30])


def test_nothing_is_known_of_a_frame_of_sky_that_is_uncertain_everywhere(tmp_path: Path):
    write_movies(tmp_path)
    for name in NAMES:
        write_png(tmp_path / f"sky/{name}.png", np.full(SIZE, 255, np.uint8))
        write_png(tmp_path / f"uncertainty/{name}.png", np.full(SIZE, 255, np.uint8))
    assert not Movies3D(tmp_path)[0].mask.any()


def test_films_that_are_not_there_are_left_out(tmp_path: Path):
    write_movies(tmp_path)
    (tmp_path / "lists/train.txt").write_text("\n".join(["avatar/chapter1/out00000001", *NAMES]))
    assert len(Movies3D(tmp_path)) == 2


def test_a_frame_of_a_film_that_is_there_must_be_there(tmp_path: Path):
    write_movies(tmp_path)
    (tmp_path / "lists/train.txt").write_text("\n".join(["exodus/chapter1/out00000001", *NAMES]))
    with pytest.raises(InputError, match=r"image_left/exodus/chapter1/out00000001\.jpg"):
        Movies3D(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        {},
        {"offset": "1.0"},
        {"offset": "much", "scale": "1"},
        {"offset": "nan", "scale": "1"},
        {"offset": "0", "scale": "-1"},
    ],
)
def test_disparity_without_its_unit_is_an_error(tmp_path: Path, text: dict[str, str]):
    write_movies(tmp_path)
    dataset = Movies3D(tmp_path)
    write_disparity(tmp_path / f"disparity/{NAMES[0]}.png", np.zeros(SIZE, np.uint16), **text)
    with pytest.raises(InputError, match=r"out00000005\.png (needs the text chunks|has offset)"):
        dataset[0]


@pytest.mark.parametrize("folder", ["uncertainty", "sky"])
def test_masks_of_another_size_are_an_error(tmp_path: Path, folder: str):
    write_movies(tmp_path)
    for name in NAMES:
        write_png(tmp_path / f"{folder}/{name}.png", np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match=rf"{folder}/.*out00000005\.png is \(2, 2\)"):
        Movies3D(tmp_path)[0]


def test_a_list_that_leads_out_of_the_folder_is_an_error(tmp_path: Path):
    write_movies(tmp_path)
    (tmp_path / "lists/train.txt").write_text("exodus/../../../etc/passwd\n")
    with pytest.raises(InputError, match="leads out of"):
        Movies3D(tmp_path)
