"""All maps in one file."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps, Options
from zoedepth.outputs.npz import NPZ

DEPTH = np.random.default_rng(1).random((4, 6)).astype(np.float32) + 1


@pytest.mark.parametrize(
    ("maps", "names"),
    [
        (Maps(depth=DEPTH, std=DEPTH / 2), {"depth", "std", "confidence", "valid"}),
        (Maps(depth=DEPTH), {"depth", "valid"}),
        (Maps(relative=DEPTH), {"relative"}),
    ],
)
def test_holds_every_bit_of_the_maps_there_are(tmp_path: Path, maps: Maps, names: set[str]) -> None:
    NPZ.write(tmp_path / "photo.npz", maps, Options())
    with np.load(tmp_path / "photo.npz", allow_pickle=False) as arrays:
        assert set(arrays) == names
        for name in names:
            assert arrays[name].dtype == (bool if name == "valid" else np.float32)
            np.testing.assert_array_equal(arrays[name], getattr(maps, name))


def test_has_the_camera_to_the_last_bit_and_who_knows_it(tmp_path: Path) -> None:
    camera = Camera((4, 6), 5 / 3, 7 / 3, 2.7, 1.1, "assumed")
    NPZ.write(tmp_path / "photo.npz", Maps(depth=DEPTH, camera=camera), Options())
    with np.load(tmp_path / "photo.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {"depth", "valid", "intrinsics", "camera_source"}
        assert arrays["intrinsics"].tolist() == [[5 / 3, 0, 2.7], [0, 7 / 3, 1.1], [0, 0, 1]]
        assert arrays["camera_source"].item() == "assumed"
