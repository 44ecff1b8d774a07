"""Score a model, and a predictor of your own beside it, on photos with known depth.

python examples/evaluate_models.py nyu/test.csv     # without data: rendered rooms
"""

import sys

import numpy as np

from zoedepth import load_model
from zoedepth.data.sample import Sample
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.evaluation_set import open_evaluation_set
from zoedepth.evaluation.predictions import ModelSource, Prediction
from zoedepth.evaluation.protocols import Protocol


class ThreeMetres:
    """Predict three metres everywhere: every model should be better."""

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Return depth in metres, at any size."""
        return Prediction(np.full(sample.target.shape[1:], 3.0, np.float32))


def main(data: str = "synthetic:rooms?n=8&seed=1") -> None:
    """Print the metrics of both, under the protocol that belongs to the data."""
    sources = {"zoed-lite": ModelSource(load_model("zoed-lite")), "three metres": ThreeMetres()}
    result = evaluate(sources, {"photos": open_evaluation_set(data)}, on_failure=print)
    for summary in result.summaries:
        if summary.metrics:
            print(f"{summary.source}: REL {summary.metrics.rel:.3f}, delta1 {summary.metrics.delta1:.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
