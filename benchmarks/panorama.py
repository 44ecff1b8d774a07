"""Measure panoramas of rendered rooms: the error of the merged distances against that of the views, and the seam."""

import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from zoedepth import Predictor, load_model
from zoedepth.geometry.panorama import cut_out, merge, panorama_views, spread
from zoedepth.synthetic.panorama import make_panorama

HEIGHT = 256
N_ROOMS = 20


def main(model: str = "zoed-lite") -> None:
    """Predict the panoramas view by view, merge them, and print a table with a row for each room."""
    predictor = Predictor(load_model(model))
    views, size = panorama_views(), (HEIGHT, 2 * HEIGHT)
    latitude = (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT) * np.pi
    area = np.repeat(np.cos(latitude)[:, None], 2 * HEIGHT, axis=1)
    table = Table(
        "room", "REL of views", "REL merged", "views x one factor", "merged x one factor",
        "disagreement", "seam", "other columns", title=f"{model}, panoramas {size[1]} x {size[0]}",
    )  # fmt: skip
    rows = []
    for room in range(N_ROOMS):
        image, truth = make_panorama("indoor", HEIGHT, np.random.default_rng((20, room)))
        pictures = [cut_out(image, view) for view in views]
        maps = predictor.batch(pictures, domain="indoor", camera=[view.camera for view in views])
        depths = [depth_map.depth for depth_map in maps]
        merged = merge(depths, views, size)
        known, weight = truth.ravel() > 0, area.ravel()
        pooled = []
        for depth, view in zip(depths, views, strict=True):
            distance = depth * np.linalg.norm(view.camera.rays(), axis=-1)
            place, values, _ = spread(np.log(distance).astype(np.float32), view, size)
            place, values = place[known[place]], values[known[place]]
            pooled.append((np.exp(values) / truth.ravel()[place], weight[place]))
        of_views = [np.concatenate(column) for column in zip(*pooled, strict=True)]
        of_merged = [merged.distance.ravel()[known] / truth.ravel()[known], weight[known]]
        log = np.log(merged.distance)
        steps = np.abs(np.diff(log, axis=1, append=log[:, :1])).mean(axis=0)
        rows.append((
            _rel(*of_views), _rel(*of_merged), _rel(*_scaled(*of_views)), _rel(*_scaled(*of_merged)),
            merged.disagreement, steps[-1], steps[:-1].mean(),
        ))  # fmt: skip
        table.add_row(str(room), *(f"{value:.4f}" for value in rows[-1]))
    table.add_row("mean", *(f"{value:.4f}" for value in np.mean(rows, axis=0)), style="bold")
    Console(width=140).print(table)


def _rel(ratio: np.ndarray, weight: np.ndarray) -> float:
    return float(np.average(np.abs(ratio - 1), weights=weight))


def _scaled(ratio: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return ratio / np.median(ratio), weight


if __name__ == "__main__":
    main(*sys.argv[1:])
