"""Small folders of photos with depth, in the format of ``zoedepth.data.pairs``, for tests that read files."""

import csv
from pathlib import Path

import numpy as np
from PIL import Image


def write_photo(path: Path, *, size: tuple[int, int] = (12, 16), seed: int = 0) -> Path:
    """Write a photo of noise, of (height, width), and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    return path


def write_pairs(
    folder: Path,
    *,
    n: int = 2,
    size: tuple[int, int] = (64, 96),
    domain: str = "indoor",
    split: str = "train",
    without_truth: tuple[int, ...] = (),
    focal_px: tuple[float, ...] = (),
) -> Path:
    """``n`` photos of (height, width) with depth, listed in ``folder/{split}.csv``; returns its path.

    The first photos get cameras of these focal lengths.

    Indoor depth is 1 to 5 m in millimetres, outdoor 5 to 60 m in 1/256 m; a strip on the left is unknown. Indoor photos
    are reddish, outdoor ones bluish, and near is bright, so that there is something to learn.
    """
    near, far, scale = (1.0, 5.0, 1000) if domain == "indoor" else (5.0, 60.0, 256)
    rows = []
    for index in range(n):
        depth = _slope(size, index) * (far - near) + near
        stored = np.round(depth * scale).astype(np.uint16)
        stored[:, : size[1] // 8] = 0
        if index in without_truth:
            stored[:] = 0
        tint = (1.0, 0.7, 0.4) if domain == "indoor" else (0.4, 0.7, 1.0)
        image = 255 * near / depth[..., None] * np.array(tint)
        name = f"{split}_{index:03d}"
        _write(folder, name, "depth", image.astype(np.uint8), stored)
        row: dict[str, object] = {"image": f"image/{name}.jpg", "depth": f"depth/{name}.png", "depth_scale": scale}
        if focal_px:
            focal = focal_px[index] if index < len(focal_px) else ""
            middle = ((size[1] - 1) / 2, (size[0] - 1) / 2) if focal else ("", "")
            row |= {"fx": focal, "fy": focal, "cx": middle[0], "cy": middle[1]}
        rows.append({**row, "domain": domain})
    return write_csv(folder / f"{split}.csv", rows)


def write_disparity_pairs(folder: Path, *, n: int = 2, size: tuple[int, int] = (64, 96)) -> Path:
    """``n`` photos of (height, width) with 8-bit disparity, 0 where unknown, listed in ``folder/train.csv``."""
    rows = []
    for index in range(n):
        stored = np.round(1 + 254 * (1 - _slope(size, index))).astype(np.uint8)
        stored[:, -size[1] // 8 :] = 0
        image = np.repeat(stored[..., None], 3, axis=2)
        name = f"still_{index:03d}"
        _write(folder, name, "disparity", image, stored)
        rows.append({"image": f"image/{name}.jpg", "disparity": f"disparity/{name}.png", "domain": ""})
    return write_csv(folder / "train.csv", rows)


def write_csv(path: Path, rows: list[dict[str, object]]) -> Path:
    """A CSV file with the keys of the first row as its header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def _slope(size: tuple[int, int], index: int) -> np.ndarray:
    """A tilted plane in [0, 1] with a nearer block, another one for every index; (height, width)."""
    rows, columns = np.linspace(0, 1, size[0])[:, None], np.linspace(0, 1, size[1])[None]
    angle = 0.7 * index
    plane = np.cos(angle) ** 2 * rows + np.sin(angle) ** 2 * columns
    plane = np.broadcast_to(plane, size).copy()
    top, left = size[0] // 2, size[1] // 3
    plane[top : top + size[0] // 4, left : left + size[1] // 4] *= 0.3
    return plane


def _write(folder: Path, name: str, kind: str, image: np.ndarray, stored: np.ndarray) -> None:
    for subfolder in ("image", kind):
        (folder / subfolder).mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(folder / "image" / f"{name}.jpg", quality=95)
    Image.fromarray(stored).save(folder / kind / f"{name}.png")
