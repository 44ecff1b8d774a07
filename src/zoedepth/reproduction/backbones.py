"""The paper's figure of backbones: REL against the accuracy of the encoder on ImageNet, with areas by parameters."""

from collections.abc import Sequence
from pathlib import Path

from zoedepth.evaluation.report import require_matplotlib
from zoedepth.images import atomic_path
from zoedepth.reproduction.run import Result
from zoedepth.reproduction.shown import Interval
from zoedepth.reproduction.units import Unit

IMAGENET_TOP1 = {
    "beit_large_patch16_512": 88.596,
    "beit_large_patch16_384": 88.402,
    "swinv2_large_window12to24_192to384": 87.464,
    "swin_large_patch4_window12_384": 87.132,
    "swinv2_base_window12to24_192to384": 87.096,
    "beit_base_patch16_384": 86.800,
    "swinv2_tiny_window16_256": 82.804,
    "tf_efficientnet_lite2": 77.464,
    "tf_efficientnet_lite1": 76.644,
    "tf_efficientnet_lite0": 74.830,
}
"""Encoder → top-1 accuracy of its weights on ImageNet's validation set, percent, as timm measured it
(``results/results-imagenet.csv`` of pytorch-image-models)."""

_LARGEST = 900.0  # area of the largest circle, in square points


def plot_backbones(units: Sequence[Unit], results: Sequence[Result | None], path: Path, *, data: str = "nyu") -> bool:
    """Plot REL against the accuracy on ImageNet, a circle for each row; its area grows with the parameters.

    Args:
        units: the work of the comparison.
        results: the result of each unit, None where it has not run.
        path: PNG to write.
        data: the data set whose REL is shown.

    Returns:
        False where nothing has run, and nothing is written.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    found: dict[str, tuple[float, list[float], int]] = {}
    for unit, result in zip(units, results, strict=True):
        metrics = None if result is None else result.scores.get(data)
        if unit.training is None or result is None or not metrics or result.n_parameters is None:
            continue
        top1 = IMAGENET_TOP1.get(unit.training.config.model.encoder_name)
        if top1 is not None:
            found.setdefault(unit.row.name, (top1, [], result.n_parameters))[1].append(metrics["rel"])
    if not found:
        return False
    require_matplotlib()
    from matplotlib.figure import Figure

    most = max(n_parameters for _, _, n_parameters in found.values())
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, (top1, values, n_parameters) in found.items():
        interval = Interval.of(values)
        axes.errorbar(top1, interval.mean, yerr=interval.half, color="0.6", capsize=3, zorder=1)
        axes.scatter(top1, interval.mean, s=_LARGEST * n_parameters / most, alpha=0.7, zorder=2)
        axes.annotate(
            f"{name}\n{n_parameters / 1e6:.0f} M", (top1, interval.mean), xytext=(0, 20), textcoords="offset points",
            fontsize=8, ha="center",
        )  # fmt: skip
    axes.set_xlabel("top-1 accuracy of the encoder on ImageNet (%)")
    axes.set_ylabel(f"REL on {data}")
    axes.margins(0.25)
    axes.grid(alpha=0.3)
    with atomic_path(path) as part:
        figure.savefig(part, format="png", dpi=150)
    return True
