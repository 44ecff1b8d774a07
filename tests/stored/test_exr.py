"""The map of an OpenEXR file is read, and a file whose channels are large together is refused."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.stored import read_depth, read_exr

OpenEXR = pytest.importorskip("OpenEXR")


def write(path: Path, channels: dict[str, np.ndarray]) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


def test_depth_is_read_in_either_precision(tmp_path: Path) -> None:
    depth = np.array([[0.5, 2, 80], [0, 1, 300.25]], np.float32)
    for dtype in (np.float16, np.float32):
        found = read_depth(write(tmp_path / "a.exr", {"Z": depth.astype(dtype)}))
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, depth.astype(dtype))


def test_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no file .*a\.exr"):
        read_exr(tmp_path / "a.exr")
    (tmp_path / "a.exr").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"a\.exr is not a readable OpenEXR file"):
        read_exr(tmp_path / "a.exr")


def test_channels_count_together(tmp_path: Path) -> None:
    zeros = np.zeros((3000, 3000), np.float32)  # 36 MB each, in a few kilobytes
    assert read_exr(write(tmp_path / "one.exr", {"Z": zeros})).shape == zeros.shape
    with pytest.raises(InputError, match=r"many\.exr.*would unpack to"):
        read_exr(write(tmp_path / "many.exr", dict.fromkeys("ZRGB", zeros)))
