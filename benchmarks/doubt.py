"""How far a model's own standard deviation can be believed, on photos whose depth was measured.

    python -m benchmarks.doubt --data nyu=nyu/test.csv kitti=kitti/test.csv [--model zoed-lite] [--camera data]

The first numbers are those of a photo's scored pixels, averaged over the photos: REL of all of them, of the half and of
the quarter that the model is surest of (std / depth is least), and of the quarter that it is least sure of; AUSE; the
share of pixels whose truth lies within one and within two standard deviations; and the median of std / depth. The last
is that of all pixels of the set together, each photo with as many: by how much REL falls where the half that the model
is least sure of is left out, so that it may leave out whole photos.
"""

from typing import Literal

import numpy as np
import tyro
from jaxtyping import Float

from zoedepth.commands.data import named_paths
from zoedepth.errors import InputError
from zoedepth.evaluation.evaluation_set import EvaluationSet, open_evaluation_set
from zoedepth.evaluation.predictions import ModelSource, prepare
from zoedepth.evaluation.scoring import scored_pixels
from zoedepth.evaluation.uncertainty import score_uncertainty
from zoedepth.weights.load import load_model

_HEAD = (
    "| data | REL | surest half | change | surest quarter | least sure quarter | AUSE | 1 std | 2 std | std / depth "
    "| change, whole set |"
)
_KEPT = 20_000
"""Pixels of each photo that the numbers of the whole set are made of."""


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
        photos = open_evaluation_set(path)
        rows, kept = [], []
        for index in range(len(photos.dataset)):
            depth, std, truth, _ = predict_scored(source, photos, index)
            if len(depth):
                rows.append(_measure(depth, std, truth))
                some = np.linspace(0, len(depth) - 1, _KEPT).astype(int)
                kept.append(np.stack([std[some] / depth[some], np.abs(depth - truth)[some] / truth[some]]))
        if not rows:
            raise InputError(f"{name}: no photo has a pixel of known depth that is scored; look at {path}")
        rel, half, surest, least, ause, one, two, ratio = np.mean(rows, axis=0)
        doubt, error = np.concatenate(kept, axis=1)
        whole = error[np.argsort(doubt)[: len(doubt) // 2]].mean() / error.mean() - 1
        print(f"| {name} | {rel:.3f} | {half:.3f} | {half / rel - 1:+.0%} | {surest:.3f} | {least:.3f} | {ause:.2f} "
              f"| {one:.0%} | {two:.0%} | {ratio:.2f} | {whole:+.0%} |", flush=True)  # fmt: skip


def predict_scored(
    source: ModelSource, photos: EvaluationSet, index: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Return depth, standard deviation and truth of a photo's scored pixels, metres, and the domain of its head.

    Raises:
        InputError: the model has no standard deviation.
    """
    sample = photos.dataset[index]
    protocol = photos.protocols[sample.domain]
    sample = prepare(sample, protocol)
    scored = scored_pixels(sample, protocol)
    prediction = source.predict(sample, protocol)
    if prediction.std is None:
        raise InputError("this model has no distribution over depth, so no standard deviation")
    domain = prediction.domain or source.model.config.domains[0].name
    return prediction.depth[scored], prediction.std[scored], sample.target[0].numpy()[scored], domain


def _measure(
    depth: Float[np.ndarray, " pixels"], std: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"]
) -> list[float]:
    """Return the numbers of one photo."""
    scores = score_uncertainty(depth, truth, std)
    relative = (np.abs(depth - truth) / truth)[np.argsort(std / depth, kind="stable")]
    quarter = max(len(relative) // 4, 1)
    parts = (relative, relative[: 2 * quarter], relative[:quarter], relative[-quarter:])
    return [*(float(part.mean()) for part in parts), scores.ause, scores.coverage1, scores.coverage2,
            float(np.median(std / depth))]  # fmt: skip


if __name__ == "__main__":
    tyro.cli(main)
