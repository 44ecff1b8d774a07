"""How far a model's own standard deviation can be believed, on photos whose depth was measured.

    python -m benchmarks.doubt --data nyu=nyu/test.csv kitti=kitti/test.csv [--model zoed-lite] [--camera data]

Each number is that of a photo's scored pixels, averaged over the photos: REL of all of them, of the half and of the
quarter that the model is surest of (std / depth is least), and of the quarter that it is least sure of; AUSE; the share
of pixels whose truth lies within one and within two standard deviations; and the median of std / depth.
"""

from typing import Literal

import numpy as np
import tyro

from zoedepth.commands.data import named_paths
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import ModelSource, prepare
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.evaluation.scoring import scored_pixels
from zoedepth.evaluation.uncertainty import score_uncertainty
from zoedepth.weights.load import load_model

_HEAD = (
    "| data | REL | surest half | change | surest quarter | least sure quarter | AUSE | 1 std | 2 std | std / depth |"
)


def main(*, data: tuple[str, ...], model: str = "zoed-lite", camera: Literal["data", "none"] = "none") -> None:
    """Measure, and print a Markdown table.

    Args:
        data: NAME=LIST of photos with depth.
        model: a name of `zoedepth models`, or a file of weights.
        camera: as in `zoedepth evaluate`.
    """
    source = ModelSource(load_model(model), camera=camera)
    print(_HEAD, f"|---|{(_HEAD.count('|') - 2) * '---:|'}", sep="\n")
    for name, path in named_paths(data).items():
        photos = PairDataset(path, split="test")
        rows = [row for row in (measure(source, photos[i]) for i in range(len(photos))) if row is not None]
        rel, half, surest, least, ause, one, two, ratio = np.mean(rows, axis=0)
        print(f"| {name} | {rel:.3f} | {half:.3f} | {half / rel - 1:+.0%} | {surest:.3f} | {least:.3f} | {ause:.2f} "
              f"| {one:.0%} | {two:.0%} | {ratio:.2f} |", flush=True)  # fmt: skip


def measure(source: ModelSource, sample: Sample) -> list[float] | None:
    """Return the numbers of one photo; None where nothing is known of its depth.

    Raises:
        InputError: the model has no standard deviation.
    """
    protocol = protocol_of(sample.domain)
    sample = prepare(sample, protocol)
    scored = scored_pixels(sample, protocol)
    if not scored.any():
        return None
    prediction = source.predict(sample, protocol)
    if prediction.std is None:
        raise InputError("this model has no distribution over depth, so no standard deviation")
    depth, std, truth = (x[scored] for x in (prediction.depth, prediction.std, sample.target[0].numpy()))
    scores = score_uncertainty(depth, truth, std)
    relative = (np.abs(depth - truth) / truth)[np.argsort(std / depth, kind="stable")]
    quarter = max(len(relative) // 4, 1)
    parts = (relative, relative[: 2 * quarter], relative[:quarter], relative[-quarter:])
    return [*(float(part.mean()) for part in parts), scores.ause, scores.coverage1, scores.coverage2,
            float(np.median(std / depth))]  # fmt: skip


if __name__ == "__main__":
    tyro.cli(main)
