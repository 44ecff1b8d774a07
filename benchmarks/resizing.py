"""What the way of resizing photos costs: a model is given photos resized as it was trained, and the other way.

    python -m benchmarks.resizing --data nyu=nyu/test.csv kitti=kitti/test.csv --every 20

A row for each data set and way: REL, delta1, and the energy of the picture's gradient at the size of the network, as a
factor of that of the way the model was trained with. Prints a Markdown table.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
import tyro

from zoedepth.data.sample import Samples
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.evaluation_set import open_evaluation_set
from zoedepth.evaluation.predictions import ModelSource, prepare
from zoedepth.evaluation.summary import summarise
from zoedepth.pixels import resize_pixels
from zoedepth.sizes import network_size
from zoedepth.weights.load import load_model

WAYS = {True: "filter against aliasing", False: "corners aligned, no filter"}


class Every(Sequence):
    """Every n-th sample of a data set."""

    def __init__(self, samples: Samples, step: int) -> None:
        self._samples, self._step = samples, step

    def __len__(self) -> int:
        return -(-len(self._samples) // self._step)

    def __getitem__(self, index):
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self._samples[index * self._step]


def main(*, data: tuple[str, ...], model: str = "zoed-lite", every: int = 1) -> None:
    """Score and print.

    Args:
        data: NAME=LIST of each data set.
        model: name or path of the model.
        every: take every n-th photo.
    """
    network = load_model(model)
    trained = network.config.antialias
    print("| data | photos | resized with | REL | delta1 | gradient energy |\n|---|---:|---|---:|---:|---:|")
    for name, _, source in (each.partition("=") for each in data):
        opened = open_evaluation_set(source, name=name)
        samples = Every(opened.dataset, every)
        energies = {way: _energy(samples, opened.protocols, network.config, way) for way in WAYS}
        for way, words in WAYS.items():
            network.config = replace(network.config, antialias=way)
            scores = score_dataset(ModelSource(network), samples, opened.protocols).scores
            found = summarise(model, name, list(scores.values()), opened.protocols).metrics
            assert found is not None
            own = " (as trained)" if way == trained else ""
            print(
                f"| {name} | {len(samples)} | {words}{own} | {found.rel:.3f} | {found.delta1:.3f} "
                f"| {energies[way] / energies[trained]:.2f} |"
            )
    network.config = replace(network.config, antialias=trained)


def _energy(samples, protocols, config, antialias: bool) -> float:
    """Return the mean squared difference of neighbours in what the network sees."""
    total, n = 0.0, 0
    for i in range(min(len(samples), 20)):
        shown = prepare(samples[i], protocols[samples[i].domain])
        height, width = shown.image.shape[1:]
        size = network_size((height, width), config.size, multiple=config.multiple, keep_aspect_ratio=True)
        pixels = resize_pixels(shown.image[None], size, antialias=antialias)
        total += float(torch.diff(pixels, dim=-1).square().mean() + torch.diff(pixels, dim=-2).square().mean())
        n += 1
    return total / max(n, 1)


if __name__ == "__main__":
    tyro.cli(main)
