"""Every kind of file of a photo of 12 megapixels: seconds, memory and size. Linux only.

    python -m benchmarks outputs

The photo and its depth are those of a rendered room at the size that networks see, enlarged as predictions are, with
noise in the photo. Each file is written in a process of its own, all in turn; the median of the times is shown. To find
the flying pixels, which files of points and surfaces do first, is part of them. Memory is the most that is resident
while the file is written, libraries, photo and depth included; the two alone take 84 MB.

Then every format of depth is read back, as large: floats must come back to the last bit, and a PNG within half a level.
"""

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from zoedepth.geometry.camera import Camera
from zoedepth.images import PNG_MAX
from zoedepth.outputs import OUTPUTS, Maps, Options, write_maps
from zoedepth.stored import read_depth

SIZE, NETWORK_SIZE, RUNS = (3000, 4000), (384, 512), 3

DEPTH_FILES = (".png", ".npy", ".npz", ".exr", ".tiff", ".pfm")

_CHILD = "import sys; from benchmarks.outputs import measure; print(*measure(sys.argv[1], sys.argv[2]))"


def main() -> None:
    kinds = [name for name, output in OUTPUTS.items() if "depth" in output.maps]
    found: dict[str, list[list[float]]] = {name: [] for name in kinds}
    with TemporaryDirectory() as folder:
        photo = Path(folder, "photo.npz")
        np.savez(photo, **_photo())
        for _ in range(RUNS):
            for name in kinds:
                done = subprocess.run(
                    [sys.executable, "-c", _CHILD, name, str(photo)], stdout=subprocess.PIPE, text=True, check=True
                )
                found[name].append([float(number) for number in done.stdout.split()])
    cores = len(os.sched_getaffinity(0))
    table = Table("kind", "seconds", "MB of memory", "MB of file", title=f"{SIZE[1]} x {SIZE[0]} pixels, {cores} cores")
    for name, rows in found.items():
        seconds, memory, size = (statistics.median(column) for column in zip(*rows, strict=True))
        table.add_row(name, f"{seconds:.1f}", f"{memory / 1e6:.0f}", f"{size / 1e6:.1f}")
    Console().print(table)
    Console().print(*(f"{suffix}: {round_trip(suffix)}" for suffix in DEPTH_FILES), sep="\n")


def round_trip(suffix: str) -> str:
    """Write depth from 0.01 mm to 1 km, a tenth of it unknown, read it back, and return what became of it.

    Raises:
        AssertionError: it did not come back as it should.
    """
    rng = np.random.default_rng(0)
    depth = (10 ** rng.uniform(-5, 3, SIZE)).astype(np.float32)
    depth[rng.random(SIZE) < 0.1] = 0
    depth[rng.random(SIZE) < 0.01] = np.nan
    unknown = ~(depth > 0)
    with TemporaryDirectory() as folder:
        written = write_maps(Path(folder, f"depth{suffix}"), Maps(depth=depth))
        found = read_depth(Path(folder, f"depth{suffix}"))
    assert not found[unknown].any(), f"{suffix}: unknown depth became known"
    if suffix != ".png":
        assert np.array_equal(found[~unknown], depth[~unknown]), f"{suffix}: depth changed"
        return "came back to the last bit"
    scale = written.facts["png_scale"]
    assert isinstance(scale, float)
    fitting = (depth * scale >= 0.5) & (depth * scale < PNG_MAX + 0.5)
    error = np.abs(found[fitting] - depth[fitting]).max()
    clipped = np.isin(found[~fitting & ~unknown] * scale, (1, PNG_MAX)).all()
    assert error <= 0.5001 / scale, f"{suffix}: depth is off by {error} m"
    assert clipped, f"{suffix}: what does not fit was not clipped"
    assert len(written.notes) == 3, f"{suffix}: that it was clipped was not said"
    return (
        f"came back within {1000 * error:.2f} mm at {scale:g} levels per metre; what does not fit was clipped, and said"
    )


def measure(name: str, photo: str) -> tuple[float, int, int]:
    """Write a file; returns seconds, the most memory resident meanwhile, and the size of the file, in bytes."""
    with np.load(photo) as arrays:
        depth, image = arrays["depth"], arrays["image"]
    path = Path(photo).with_name(f"written{OUTPUTS[name].ending}")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak is that from here on
    start = time.perf_counter()
    maps = Maps(depth=depth, image=image, camera=Camera.from_fov(SIZE, horizontal=65.0))
    OUTPUTS[name].write(path, maps, Options())
    seconds = time.perf_counter() - start
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = 1024 * int(status.split("VmHWM:")[1].split()[0])
    return seconds, peak, path.stat().st_size


def _photo() -> dict[str, np.ndarray]:
    """Return depth and image of a room."""
    # The processes that write do without torch, which takes memory of its own.
    import torch.nn.functional as F

    from zoedepth.synthetic.dataset import SyntheticScenes

    scene = SyntheticScenes(1, size=NETWORK_SIZE, seed=3, domains=("indoor",))[0]
    depth = scene.target.where(scene.mask, scene.target[scene.mask].median())[None]
    depth = F.avg_pool2d(F.pad(depth, (2, 2, 2, 2), mode="replicate"), 5, 1)  # networks do not see sharply
    depth = F.interpolate(depth, SIZE, mode="bicubic")[0, 0].numpy()
    image = F.interpolate(scene.image[None], SIZE, mode="bicubic")[0].permute(1, 2, 0).numpy()
    image = 255 * image + np.random.default_rng(0).normal(0, 4, image.shape)
    return {"depth": depth, "image": image.clip(0, 255).astype(np.uint8)}
