"""What one step of the inverse attractor does to bin centers: the sum of the pulls, and their mean.

    python -m benchmarks.attractors

Prints a Markdown table.
"""

import torch
import tyro

from zoedepth.model.heads.attractor import attract


def main(*, points: int = 16, alpha: float = 300.0, gamma: float = 2.0, reach: float = 0.1) -> None:
    """Pull 201 centers around attractors that coincide at 1 m.

    Args:
        points: number of attractors.
        alpha: their strength.
        gamma: exponent of the distance.
        reach: metres from the attractors to the farthest center.
    """
    centers = torch.linspace(1 - reach, 1 + reach, 201).view(1, -1, 1, 1)
    attractors = torch.ones(1, points, 1, 1)
    print("| pulls | farthest center, before | after | neighbours out of order, of 200 |\n|---|---:|---:|---:|")
    for reduce in ("sum", "mean"):
        moved = attract(centers, attractors, kind="inverse", reduce=reduce, alpha=alpha, gamma=gamma).flatten()
        print(f"| {reduce} | {reach:.2f} m | {(moved - 1).abs().max():.2f} m | {int((moved.diff() < 0).sum())} |")


if __name__ == "__main__":
    tyro.cli(main)
