"""Maps in HDF5 files are read however they are packed, and refused where they are not, or not only, in the file."""

from pathlib import Path

import numpy as np
import pytest
from tests import bombs

from zoedepth.errors import InputError
from zoedepth.stored import read_hdf5

h5py = pytest.importorskip("h5py")

METRES = np.array([[0.5, 1.25, 0], [300.25, 2, 65.5]], np.float32)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "gzip", "compression_opts": 9},
        {"compression": "gzip", "shuffle": True, "fletcher32": True, "chunks": (7, 11)},
        {"compression": "lzf", "shuffle": True},
        {"chunks": (50, 70)},
        {"chunks": (100, 200), "maxshape": (None, None), "compression": "gzip"},
        {"chunks": (2, 2), "compression": "gzip"},
        {"scaleoffset": 0, "compression": "gzip"},
    ],
    ids=str,
)
@pytest.mark.parametrize("noise", [True, False])
def test_map_is_read_however_it_is_packed(tmp_path: Path, options: dict, noise: bool) -> None:
    """Noise cannot be compressed, and HDF5 leaves such chunks unpacked."""
    values = np.random.default_rng(0).integers(0, 2**16, (60, 80)).astype(np.uint16)
    values = values if noise else values // 60000
    bombs.hdf5(tmp_path / "a.h5", lambda file: file.create_dataset("depth", data=values, **options))
    np.testing.assert_array_equal(read_hdf5(tmp_path / "a.h5", "depth"), values)


def test_values_in_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(400))
    bombs.hdf5(tmp_path / "other.h5", lambda file: file.create_dataset("depth", data=METRES))
    layout = h5py.VirtualLayout((2, 3), "f4")
    layout[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "depth", (2, 3))
    external = [(str(tmp_path / "secret"), 0, 400)]
    for write in (
        lambda file: file.create_dataset("depth", (10, 10), "f4", external=external),
        lambda file: file.create_virtual_dataset("depth", layout),
        lambda file: file.__setitem__("depth", h5py.ExternalLink(str(tmp_path / "other.h5"), "depth")),
        lambda file: (
            file.__setitem__("x", h5py.ExternalLink(str(tmp_path / "other.h5"), "depth")),
            file.__setitem__("depth", h5py.SoftLink("/x")),
        ),
    ):
        bombs.hdf5(tmp_path / "a.h5", write)
        with pytest.raises(InputError, match=r"a\.h5.*other? files?|a\.h5.*another file"):
            read_hdf5(tmp_path / "a.h5", "depth")


@pytest.mark.parametrize("write", [
    lambda file: file.create_group("depth"),
    lambda file: file.create_dataset("other", data=METRES),
    lambda file: file.create_dataset("depth", data=METRES[None]),
    lambda file: file.create_dataset("depth", data=np.array([["a"]], "S1")),
], ids=["group", "no such key", "three axes", "text"])  # fmt: skip
def test_file_without_such_a_map(tmp_path: Path, write) -> None:
    bombs.hdf5(tmp_path / "a.h5", write)
    with pytest.raises(InputError, match=r"a\.h5 is not an HDF5 file with a map 'depth'"):
        read_hdf5(tmp_path / "a.h5", "depth")


def test_many_chunks(tmp_path: Path) -> None:
    """To find a chunk by its number, HDF5 passes over all chunks before it: 65,536 of them took 90 s."""
    values = np.arange(128 * 128, dtype=np.float32).reshape(128, 128)
    path = tmp_path / "a.h5"
    bombs.hdf5(path, lambda file: file.create_dataset("depth", data=values, chunks=(2, 2), compression="gzip"))
    np.testing.assert_array_equal(read_hdf5(path, "depth"), values)
    bombs.hdf5(path, lambda file: file.create_dataset("depth", (256, 256), "f4", chunks=(1, 1), compression="gzip"))
    with pytest.raises(InputError, match="more than 32,768 chunks"):
        read_hdf5(path, "depth")


def test_chunks_that_were_never_written_are_zero(tmp_path: Path) -> None:
    def write(file) -> None:
        file.create_dataset("depth", (8, 8), "f4", chunks=(4, 4), compression="gzip")[:2, :2] = 1

    bombs.hdf5(tmp_path / "a.h5", write)
    expected = np.zeros((8, 8))
    expected[:2, :2] = 1
    np.testing.assert_array_equal(read_hdf5(tmp_path / "a.h5", "depth"), expected)


def test_keys_are_listed_where_there_is_no_such_map(tmp_path: Path) -> None:
    def write(file) -> None:
        for name in ("rgb", "depth_m", "pose"):
            file.create_dataset(name, data=np.ones((2, 3), np.float32))

    bombs.hdf5(tmp_path / "a.h5", write)
    with pytest.raises(InputError, match=r"a\.h5 is not an HDF5 file with a map 'depth' \(it has depth_m, pose, rgb\)"):
        read_hdf5(tmp_path / "a.h5", "depth")
