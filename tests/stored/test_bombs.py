"""Small files of every format cannot fill the memory."""

import importlib.util
import json
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, features
from tests import bombs

from zoedepth.stored import read_depth

QUICK = {"webp": {"method": 0}, "avif": {"speed": 10}}
h5py = pytest.importorskip("h5py") if importlib.util.find_spec("h5py") else None

# A child reads all of them: [reader, arguments] in, [message, peak of memory in MiB above that at its start] out.
CHILD = """
import json, resource, sys
from pathlib import Path
import zoedepth.stored
from zoedepth.errors import InputError
from zoedepth.images import read_image
from PIL import Image
for library in ("h5py", "OpenEXR"):
    try: __import__(library)
    except ImportError: pass
Image.init()
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))

def peak():
    if sys.platform == "linux":  # where ru_maxrss begins with the peak of the parent
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << (20 if sys.platform == "darwin" else 10))

start = peak()
for reader, path, *rest in json.loads(sys.argv[1]):
    read = read_image if reader == "read_image" else getattr(zoedepth.stored, reader)
    try: message = f"no error, but {type(read(Path(path), *rest))}"
    except InputError as error: message = str(error)
    print(json.dumps([message[:500], peak() - start]), flush=True)
"""


def write_bombs(folder: Path) -> list[list[str]]:
    """Write a bomb of every format; returns reader, path and further arguments of each."""
    size = 2**32 - 16
    start = bombs.npy_header((32768, 32768))
    long = b"\x93NUMPY\2\0" + b"\xff\xff\xff\xff"  # a header of 4 GiB
    files: dict[str, bytes] = {
        "zeros.npz": bombs.zip_of("depth.npy", bombs.deflated(start, bombs.GIGABYTES), size),
        "header.npz": bombs.zip_of("depth.npy", bombs.deflated(long, bombs.GIGABYTES), size),
        "entries.npz": bombs.zip_of("depth.npy", b"\3\0", 0, entries=300_000),
        "float64.npz": bombs.zip_of("depth.npy", bombs.deflated(bombs.npy_header((12000, 12000), "<f8"), 1200), 2**30),
        "claims.npy": bombs.npy_header((10**6, 10**6)),
        "cut.npy": bombs.npy_header((13000, 13000)),
        "header.npy": long + bytes(100),
        "zeros.png": bombs.png(30_000, 30_000),
        "text.png": bombs.png(8, 8, extra=bombs.chunk(b"zTXt", b"DepthScale\0\0" + bombs.zeros(1024))),
        "fits.png": bombs.png(12_000, 12_000),
        "fits.npz": bombs.zip_of("depth.npy", bombs.deflated(bombs.npy_header((9000, 9000)), 400), 4 * 9000**2 + 128),
        "zeros.tif": bombs.tiff(30_000, 30_000),
        "tile.tif": bombs.tiff(8, 8, tile=(20_000, 20_000)),
        "claims.pfm": b"Pf\n1000000 1000000\n-1.0\n",
        "cut.pfm": b"Pf\n13000 13000\n-1.0\n",
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
    found = [["read_pfm" if name.endswith("pfm") else "read_depth", str(folder / name)] for name in files]
    found += [["read_mask", str(folder / "zeros.png")], ["read_image", str(folder / "tile.tif")],
              ["read_image", str(folder / "zeros.png")]]  # fmt: skip
    for suffix in ("webp", "jp2", "avif") if features.check("avif") else ("webp", "jp2"):
        # Decoders that keep several copies. The quickest encoder does: how small the file is does not matter.
        Image.new("RGB", (5200, 5200)).save(folder / f"flat.{suffix}", **QUICK.get(suffix, {}))
        found.append(["read_image", str(folder / f"flat.{suffix}")])
    if importlib.util.find_spec("OpenEXR"):
        bombs.exr(folder / "claims.exr", 30_000, 30_000)
        found.append(["read_depth", str(folder / "claims.exr")])
    if h5py is not None:

        def grow(file) -> None:
            dataset = file.create_dataset("depth", (8, 8), "f4", chunks=(8, 8), compression="gzip")
            dataset.id.write_direct_chunk((0, 0), bombs.zeros(1024))

        def large_chunk(file) -> None:
            shape, chunks = (8, 8), (16_000, 16_000)
            dataset = file.create_dataset(
                "depth", shape, "f4", chunks=chunks, maxshape=(None, None), compression="gzip"
            )
            dataset.id.write_direct_chunk((0, 0), bombs.zeros(1024))

        def filters(file) -> None:
            """A chunk of 1 MiB holds, packed twice, 1 GiB."""
            plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            plan.set_chunk((512, 512))
            plan.set_deflate(9)
            plan.set_deflate(9)
            space = h5py.h5s.create_simple((512, 512))
            dataset = h5py.h5d.create(file.id, b"depth", h5py.h5t.NATIVE_FLOAT, space, plan)
            dataset.write_direct_chunk((0, 0), zlib.compress(bombs.zeros(960)))

        def many_chunks(file) -> None:
            file.create_dataset("depth", (13_000, 13_000), "u1", chunks=(1, 1))

        def claims(file) -> None:
            file.create_dataset("depth", (10**6, 10**6), "f4", chunks=(512, 512), compression="gzip")

        for write in (grow, large_chunk, filters, many_chunks, claims):
            bombs.hdf5(folder / f"{write.__name__}.h5", write)
            found.append(["read_hdf5", str(folder / f"{write.__name__}.h5"), "depth"])
    return found


def test_bombs_of_every_format_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="the operating system does not say what memory a process took")
    told = write_bombs(tmp_path)
    assert max(Path(path).stat().st_size for _, path, *_ in told) < 30_000_000
    done = subprocess.run([sys.executable, "-c", CHILD, json.dumps(told)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(answers) == len(told)
    before = 0.0
    for (reader, path, *_), (message, peak) in zip(told, answers, strict=True):
        assert path in message, f"{reader} of {Path(path).name}: {message}"
        assert peak - before < 100, f"{reader} of {Path(path).name} took {peak - before:.0f} MiB"
        before = peak
    assert before < 200


def test_scattered_points_of_a_large_photo_are_no_bomb(tmp_path: Path) -> None:
    """Twenty megapixels with a point of lidar in every 200 pixels take 40 MB, and less than a hundredth on the disk."""
    values = np.zeros((4000, 5000), np.uint16)
    values.flat[::200] = np.random.default_rng(0).integers(1, 2**16, 100_000)
    Image.fromarray(values).save(tmp_path / "depth.png")
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.png", scale=1), values)
