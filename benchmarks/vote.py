"""What one head for a whole batch costs: photos of rooms and of streets, in pairs, through both routings.

    python -m benchmarks.vote --indoor nyu/test.csv --outdoor kitti/test.csv [--model zoed-lite]

Every pair holds a room and a street, squeezed to one size as a batch demands. "own head" is what this package does,
"vote" what the released code and transformers do with a batch of two.
"""

from pathlib import Path

import numpy as np
import torch
import tyro

from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.evaluation.predictions import Prediction
from zoedepth.evaluation.protocols import PROTOCOLS
from zoedepth.evaluation.scoring import score
from zoedepth.metrics import Metrics, mean_metrics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.weights.load import load_model


def main(*, indoor: Path, outdoor: Path, model: str = "zoed-lite", pairs: int = 38) -> None:
    """Score both routings on the same pairs."""
    rooms, streets = PairDataset(indoor, split="test"), PairDataset(outdoor, split="test")
    count = min(pairs, len(rooms), len(streets))
    # Spread over the longer set.
    couples = [(rooms[i * len(rooms) // count], streets[i * len(streets) // count]) for i in range(count)]
    for label, compat in (("own head", ("squeeze",)), ("vote", ("squeeze", "batch-vote"))):
        network = load_model(model, compat=compat)
        results = [_scores(network, couple) for couple in couples]
        for kind, row in (("rooms", 0), ("streets", 1)):
            metrics = [result[row] for result in results]
            mean = mean_metrics([found for found, _ in metrics if found is not None])
            wrong = np.mean([domain != ("indoor", "outdoor")[row] for _, domain in metrics])
            print(f"{label:<9} {kind:<8} REL {mean.rel:.3f}  delta1 {mean.delta1:.3f}  wrong head {100 * wrong:.0f} %")


def _scores(network: ZoeDepth, couple: tuple[Sample, Sample]) -> list[tuple[Metrics | None, str]]:
    predictor = Predictor(network, pad=False, flip_average=False, upsampling="bilinear")
    with torch.inference_mode():
        results = predictor.batch([sample.image for sample in couple])
    scores = [
        score(Prediction(result.depth), sample, PROTOCOLS[sample.domain])
        for result, sample in zip(results, couple, strict=True)
    ]
    return [
        (None if found.sums is None else found.sums.metrics(), result.domain)
        for found, result in zip(scores, results, strict=True)
    ]


if __name__ == "__main__":
    tyro.cli(main)
