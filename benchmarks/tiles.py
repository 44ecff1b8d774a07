"""Tiles against the whole photo, on rendered scenes of 3840 x 2160 whose every edge is known; and their memory.

    python -m benchmarks.tiles [FOLDER]

The scenes are rendered once into the folder, which takes a minute or so each; their seeds are none that a model was
trained on. The model is zoed-lite, and it is told the camera. F1 is that of occluding edges (``boundary_f1``): at the
size of the photo, where depth must jump from one pixel to the next, and of every fourth, eighth ... pixel both ways.
Memory is the most that is resident in a process of its own, which predicts one photo of noise.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table

from zoedepth import Predictor, load_for_prediction, predict_tiled
from zoedepth.depth_map import DepthMap
from zoedepth.evaluation.boundaries import boundary_f1
from zoedepth.evaluation.uncertainty import score_uncertainty
from zoedepth.geometry.camera import Camera
from zoedepth.images import ImageArray
from zoedepth.metrics import compute_metrics
from zoedepth.synthetic.dataset import make_picture

SIZE, SEED, N_SCENES = (2160, 3840), 24, 6
GRIDS: tuple[tuple[int, int] | None, ...] = (None, (2, 2), (4, 4), (6, 6))
STEPS = (1, 4, 8, 16)
_DOUBT_STEP = 4  # of the pixels whose deviation is scored, both ways
LARGE = ((4096, 8192), (8660, 11547))

_CHILD = "import sys; from benchmarks.tiles import peak; print(peak(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))"


def main(folder: str | None = None) -> None:
    """Print the scores of each number of tiles, mean over the scenes, and the memory of large photos."""
    with TemporaryDirectory() as temporary:
        scores(Path(folder or temporary))
    memory()


def scores(folder: Path) -> None:
    predictor = Predictor(load_for_prediction("zoed-lite"))
    rows: dict[tuple[int, int] | None, list[list[float]]] = {grid: [] for grid in GRIDS}
    for number in range(N_SCENES):
        image, truth, camera = scene(folder, number)
        for grid in GRIDS:
            found = (
                predictor(image, camera=camera)
                if grid is None
                else predict_tiled(predictor, image, tiles=grid, camera=camera)
            )
            rows[grid].append(score(found, truth))
    titles = [
        "tiles",
        *(f"F1 of {SIZE[1] // step} x {SIZE[0] // step}" for step in STEPS),
        "REL",
        "delta1",
        "AUSE",
        "within 1 std",
    ]
    table = Table(*titles, title=f"zoed-lite, {N_SCENES} scenes of {SIZE[1]} x {SIZE[0]}")
    for grid, values in rows.items():
        name = "none" if grid is None else f"{grid[0]}x{grid[1]}"
        table.add_row(name, *(f"{value:.4f}" for value in np.mean(values, axis=0)))
    Console(width=120).print(table)


def scene(folder: Path, number: int) -> tuple[ImageArray, np.ndarray, Camera]:
    """Return a photo, its true depth and its camera, rendered where the folder does not have them."""
    domain = ("indoor", "outdoor")[number % 2]
    file = folder / f"{number:02d}-{domain}.npz"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        image, depth, camera = make_picture(domain, SIZE, np.random.default_rng((SEED, number)))
        Image.fromarray(image).save(file.with_suffix(".png"), compress_level=1)
        np.savez(file, depth=depth, camera=np.array([camera.fx, camera.fy, camera.cx, camera.cy]))
    with Image.open(file.with_suffix(".png")) as picture, np.load(file) as known:
        return np.array(picture), known["depth"], Camera(SIZE, *known["camera"].tolist())


def score(found: DepthMap, truth: np.ndarray) -> list[float]:
    known = truth > 0
    edges = [boundary_f1(found.depth[::s, ::s], truth[::s, ::s], known[::s, ::s]) or 0.0 for s in STEPS]
    metrics = compute_metrics(found.depth[known], truth[known])
    assert found.std is not None
    some = np.s_[::_DOUBT_STEP, ::_DOUBT_STEP]
    depth, std, truth, known = found.depth[some], found.std[some], truth[some], known[some]
    doubt = score_uncertainty(depth[known], truth[known], std[known])
    return [*edges, metrics.rel, metrics.delta1, doubt.ause, doubt.coverage1]


def memory() -> None:
    table = Table("photo", "tiles", "peak MB", title="memory, zoed-lite")
    for height, width in LARGE:
        for tiles in ("none", "auto"):
            done = subprocess.run(
                [sys.executable, "-c", _CHILD, str(height), str(width), tiles],
                stdout=subprocess.PIPE, text=True, check=True,
            )  # fmt: skip
            table.add_row(f"{width} x {height}", tiles, done.stdout.strip())
    Console().print(table)


def peak(height: int, width: int, tiles: str) -> int:
    """Predict one photo, and return the most memory that this process ever had, in MB."""
    import resource

    rng = np.random.default_rng(0)
    small = Image.fromarray(rng.integers(0, 256, (height // 64, width // 64, 3), dtype=np.uint8))
    image = np.array(small.resize((width, height)))
    predictor = Predictor(load_for_prediction("zoed-lite"))
    if tiles == "none":
        predictor(image)
    else:
        predict_tiled(predictor, image)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


if __name__ == "__main__":
    main(*sys.argv[1:])
