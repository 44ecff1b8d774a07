"""What a depth map says of itself, and the files it writes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.geometry.lens import Lens
from zoedepth.stored import read_depth


def depth_map(*, std: float | None = 0.1) -> DepthMap:
    """A slope from 1 m to 5 m; its standard deviation is the given share of the depth."""
    depth = np.linspace(1, 5, 40 * 60, dtype=np.float32).reshape(40, 60)
    photo = np.full((40, 60, 3), 90, np.uint8)
    spread = None if std is None else (std * depth).astype(np.float32)
    return DepthMap(depth, spread, "indoor", {"indoor": 1.0}, photo, (64, 96), Lens(fov_x=60).camera((40, 60)))


def test_size_and_confidence() -> None:
    result = depth_map()
    assert result.size == (40, 60)
    np.testing.assert_allclose(result.confidence, 1 / 1.1, rtol=1e-6)
    assert depth_map(std=None).confidence is None


def test_save_writes_in_the_format_of_the_suffix(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    result = depth_map()
    result.save(tmp_path / "depth.png")
    np.testing.assert_allclose(read_depth(tmp_path / "depth.png"), result.depth, atol=5.1e-4)
    result.save(tmp_path / "kitti.png", scale=256.0)
    np.testing.assert_allclose(read_depth(tmp_path / "kitti.png", scale=256.0), result.depth, atol=2e-3)
    for name in ("depth.npy", "depth.npz"):
        result.save(tmp_path / name)
        np.testing.assert_array_equal(read_depth(tmp_path / name), result.depth)
    with np.load(tmp_path / "depth.npz") as arrays:
        np.testing.assert_array_equal(arrays["std"], result.std)
        np.testing.assert_array_equal(arrays["confidence"], result.confidence)
    for limit in (None, 50):
        result.save(tmp_path / "depth.glb", max_triangles=limit)
        (mesh,) = trimesh.load(tmp_path / "depth.glb").geometry.values()
        assert len(mesh.faces) == 2 * 39 * 59 if limit is None else 10 < len(mesh.faces) <= limit
    result.save(tmp_path / "depth.jpg")
    with Image.open(tmp_path / "depth.jpg") as picture:
        assert picture.size == result.preview().shape[1::-1]
    with pytest.raises(InputError, match=r"depth\.txt"):
        result.save(tmp_path / "depth.txt")


def test_a_map_without_std_saves_depth_alone(tmp_path: Path) -> None:
    depth_map(std=None).save(tmp_path / "depth.npz")
    with np.load(tmp_path / "depth.npz") as arrays:
        assert "depth" in arrays
        assert not {"std", "confidence"} & set(arrays)
