"""Which of the two focal lengths of a photo counts: its depth when it is stretched along one axis alone.

    python -m benchmarks.stretching --data nyu=nyu/test.csv kitti=kitti/test.csv [--model zoed-lite]

Photos are resized to the network as they are, and once more with one side longer or shorter. Prints a Markdown table:
the median over the photos of the factor by which the median depth changes. ``--every 22`` takes every 22nd photo.
"""

from pathlib import Path

import numpy as np
import torch
import tyro

from zoedepth.commands.data import named_paths
from zoedepth.data.pairs import PairDataset
from zoedepth.evaluation.predictions import prepare
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.model.interface import DepthModel
from zoedepth.pixels import resize_pixels
from zoedepth.sizes import network_size
from zoedepth.weights.load import load_model

STRETCHES = ((0.7, 1.0), (1.4, 1.0), (1.0, 0.7), (1.0, 1.4))
"""(vertical, horizontal) factors, up to rounding to what the network takes."""


def main(*, data: tuple[str, ...], model: str = "zoed-lite", every: int = 2) -> None:
    """Predict the stretched photos of every data set."""
    network = load_model(model)
    print("| data | height | width | depth | 1 / height | 1 / sqrt(height width) |\n|---|---:|---:|---:|---:|---:|")
    for name, path in named_paths(data).items():
        for vertical, horizontal in STRETCHES:
            rows = _depths(network, path, vertical, horizontal, every)
            height, width, depth = np.median(rows, axis=0)
            numbers = (height, width, depth, 1 / height, (height * width) ** -0.5)
            print(f"| {name} | {' | '.join(f'{number:.2f}' for number in numbers)} |", flush=True)


@torch.inference_mode()
def _depths(
    model: DepthModel, path: Path, vertical: float, horizontal: float, every: int
) -> list[tuple[float, float, float]]:
    """Return, for each photo, by how much its height and width at the network, and its depth, have changed."""
    dataset, config, found = PairDataset(path, split="test"), model.config, []
    for index in range(0, len(dataset), every):
        sample = prepare(dataset[index], protocol_of(dataset[index].domain))
        domain = torch.tensor([[known.name for known in config.domains].index(sample.domain)])
        size = (sample.image.shape[1], sample.image.shape[2])
        plain = network_size(size, config.size, multiple=config.multiple, keep_aspect_ratio=config.keep_aspect_ratio)
        other = (_rounded(plain[0] * vertical, config.multiple), _rounded(plain[1] * horizontal, config.multiple))
        before, after = (
            model(resize_pixels(sample.image[None], one, antialias=config.antialias), domain=domain).depth.median()
            for one in (plain, other)
        )
        found.append((other[0] / plain[0], other[1] / plain[1], float(after / before)))
    return found


def _rounded(side: float, multiple: int) -> int:
    return max(multiple, round(side / multiple) * multiple)


if __name__ == "__main__":
    tyro.cli(main)
