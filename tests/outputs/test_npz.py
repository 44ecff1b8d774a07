"""All maps in one file."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.outputs import Maps, Options
from zoedepth.outputs.npz import NPZ

DEPTH = np.random.default_rng(1).random((4, 6)).astype(np.float32) + 1


@pytest.mark.parametrize(
    ("maps", "names"),
    [
        (Maps(depth=DEPTH, std=DEPTH / 2), {"depth", "std", "confidence"}),
        (Maps(depth=DEPTH), {"depth"}),
        (Maps(relative=DEPTH), {"relative"}),
    ],
)
def test_holds_every_bit_of_the_maps_there_are(tmp_path: Path, maps: Maps, names: set[str]) -> None:
    NPZ.write(tmp_path / "photo.npz", maps, Options())
    with np.load(tmp_path / "photo.npz", allow_pickle=False) as arrays:
        assert set(arrays) == names
        for name in names:
            assert arrays[name].dtype == np.float32
            np.testing.assert_array_equal(arrays[name], getattr(maps, name))
