"""Compute the paper's relative improvements over a reference, in percent (section 4.3, "Evaluation Metrics").

With r the reference's score and t the method's: (r - t) / r where lower is better, (t - r) / r where higher is better.
"""

import math
from collections.abc import Mapping

from zoedepth.errors import InputError
from zoedepth.metrics import HIGHER_IS_BETTER

MRI_METRICS = ("delta1", "rel", "rmse")
"""Metrics that the paper's mRI over metrics is the mean of (captions of Tables 3 and 4)."""


def relative_improvement(value: float, reference: float, *, higher_is_better: bool) -> float:
    """Compute the improvement of a score over a reference's, in percent of the reference; negative where it is worse.

    Raises:
        InputError: the score is not finite, or the reference is not finite and > 0.
    """
    if not math.isfinite(value) or not (math.isfinite(reference) and reference > 0):
        raise InputError(
            f"relative improvement needs a finite score and a finite reference > 0; got {value} and {reference}"
        )
    gain = value - reference if higher_is_better else reference - value
    return 100 * gain / reference


def mri_datasets(rel: Mapping[str, float], reference: Mapping[str, float]) -> float:
    """Compute mRI_D: the mean over data sets of the improvement of REL, percent.

    Table 2 has it over NYU, KITTI, iBims-1 and Virtual KITTI 2; the reference is NeWCRFs trained on NYU and KITTI.

    Args:
        rel: data set → the method's REL.
        reference: data set → the reference's REL, for the same data sets.

    Raises:
        InputError: there is no data set, or the two mappings have different ones; or see ``relative_improvement``.
    """
    if not rel or rel.keys() != reference.keys():
        raise InputError(
            f"mRI over data sets needs REL of method and reference on the same data sets; got {sorted(rel)} and "
            f"{sorted(reference)}"
        )
    gains = [relative_improvement(rel[name], reference[name], higher_is_better=False) for name in rel]
    return math.fsum(gains) / len(gains)


def mri_metrics(metrics: Mapping[str, float], reference: Mapping[str, float]) -> float:
    """Compute mRI_theta: the mean over delta1, REL and RMSE of the improvement on one data set, percent.

    Tables 3 and 4 have it for each data set; the reference is NeWCRFs trained on NYU or on KITTI. Other metrics in the
    mappings are ignored.

    Args:
        metrics: field of ``Metrics`` → the method's score.
        reference: field of ``Metrics`` → the reference's score.

    Raises:
        InputError: one of the three metrics is missing; or see ``relative_improvement``.
    """
    for scores in (metrics, reference):
        missing = [name for name in MRI_METRICS if name not in scores]
        if missing:
            raise InputError(f"mRI over metrics needs {', '.join(MRI_METRICS)}; missing is {', '.join(missing)}")
    gains = [
        relative_improvement(metrics[name], reference[name], higher_is_better=name in HIGHER_IS_BETTER)
        for name in MRI_METRICS
    ]
    return math.fsum(gains) / len(gains)
