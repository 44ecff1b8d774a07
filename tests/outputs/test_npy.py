"""NumPy's array of metres."""

from pathlib import Path

import numpy as np

from zoedepth.outputs import Maps, Options
from zoedepth.outputs.npy import NPY


def test_holds_every_bit_of_the_depth(tmp_path: Path) -> None:
    depth = np.random.default_rng(1).random((4, 6)).astype(np.float32)
    NPY.write(tmp_path / "depth.npy", Maps(depth=depth, std=depth), Options(png_scale=256.0))
    found = np.load(tmp_path / "depth.npy", allow_pickle=False)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, depth)
