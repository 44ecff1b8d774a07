"""Score the released weights on the official data sets, and set the numbers beside those that the paper prints."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

from zoedepth.datasets import DATASETS
from zoedepth.errors import InputError
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.evaluation_set import EvaluationSet, open_evaluation_set
from zoedepth.evaluation.paper_numbers import datasets, method_rows
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.protocols import find_protocol
from zoedepth.evaluation.tables import NOT_RUN, ReportTable
from zoedepth.metrics import HEADINGS
from zoedepth.weights.releases import RELEASES

MODELS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "zoed-m12-n": ("ZoeD-M12-N", ("indoor",)),
    "zoed-m12-k": ("ZoeD-M12-K", ("outdoor",)),
    "zoed-m12-nk": ("ZoeD-M12-NK", ("indoor", "outdoor")),
}
"""Name of released weights → (the paper's name, the domains that the paper scores it on)."""
TITLE = "The released weights against the paper's numbers"
"""Title of the table of differences; it begins the report."""

VARIANTS: Mapping[str, str] = {"paper": "", "released": "-released"}
"""Protocol, in words → what its name in ``PROTOCOLS`` ends with."""

_METRICS = ("rel", "rmse", "delta1")


@dataclass(frozen=True)
class Found:
    """The files to verify with, and those that are not there."""

    weights: dict[str, str] = field(default_factory=dict)
    """Name of a model → file, or the name that is downloaded."""
    data: dict[str, Path] = field(default_factory=dict)
    """Name of a data set → its official folder."""
    missing: dict[str, str] = field(default_factory=dict)
    """Name of a model or data set → what is missing, and where it was looked for."""


def find_files(folder: Path, *, download: bool = False) -> Found:
    """Look for the released weights and the official data sets.

    Args:
        folder: has the data sets in folders of their names (nyu, kitti, ibims ...), and the weights under the names
            that they were published with, beside the data or in ``weights``.
        download: weights that are not there are to be downloaded.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}: give the one that holds the data sets, nyu, kitti and others")
    found = Found()
    for model in MODELS:
        release = RELEASES[model]
        places = [parent / name for parent in (folder / "weights", folder) for name in _names(model, release.file)]
        file = next((path for path in (*places, release.path) if path.is_file()), None)
        if file is not None:
            found.weights[model] = str(file)
        elif download:
            found.weights[model] = model
        else:
            found.missing[model] = f"no {release.file} in {folder / 'weights'}; --download fetches it ({release.size})"
    for name, about in datasets().items():
        if name not in DATASETS:
            continue
        if (folder / name).is_dir():
            found.data[name] = folder / name
        else:
            found.missing[name] = f"no folder {folder / name} with {about.name}; see {DATASETS[name].about.page}"
    return found


def _names(model: str, file: str) -> Iterable[str]:
    return file, f"{model}.safetensors", f"{model}.pt"


@dataclass(frozen=True)
class Difference:
    """A printed number, and what was measured under each of the protocols."""

    model: str
    """The paper's name."""
    data: str
    metric: str
    printed: Decimal
    measured: Mapping[str, float]
    """Protocol in words, "paper" or "released" → value; nothing where it was not run."""


def verify(
    found: Found,
    *,
    out: Path,
    device: str = "auto",
    track: Callable[[list[int], str], Iterable[int]] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> list[Difference]:
    """Score every model on the data sets that the paper scores it on, under both protocols.

    Args:
        found: the files. What turns out to be incomplete or damaged is added to ``found.missing``.
        out: folder of the scores; the same call goes on where it was interrupted.
        device: cpu, cuda, mps, or auto for the best there is.
        track: see ``zoedepth.evaluation.evaluate.evaluate``.
        say: receives a line about each image that fails.

    Returns:
        One for each number that the paper prints; those of which something is missing have nothing measured.

    Raises:
        InputError: the folder of the scores cannot be written to, or weights cannot be loaded.
    """
    opened = {name: sets for name in found.data if (sets := _sets(found, name)) is not None}
    measured: dict[tuple[str, str, str], Mapping[str, float]] = {}
    for model, weights in found.weights.items():
        mine = {name: sets for name, sets in opened.items() if model in _models_for(name)}
        if not mine:
            continue
        source = ModelSource.load(weights, device=device)
        for name, sets in mine.items():
            # Where both protocols are the same, their numbers are, too.
            names = {find_protocol(each).hash: each for each in reversed(sets)}.values()
            distinct = {each: sets[each] for each in names}
            scored = evaluate({model: source}, distinct, folder=out, track=track, on_failure=say)
            for summary in scored.summaries:
                if summary.n_failed:
                    found.missing[name] = f"{summary.n_failed} photos of {found.data[name]} could not be scored"
                elif summary.metrics is None:
                    found.missing[name] = f"no photo of {found.data[name]} has a known depth under the protocol"
                else:
                    values = {metric: float(getattr(summary.metrics, metric)) for metric in _METRICS}
                    for variant, end in VARIANTS.items():
                        if find_protocol(f"{name}{end}").hash == find_protocol(summary.data).hash:
                            measured[model, name, variant] = values
    return _differences(measured)


def _sets(found: Found, name: str) -> dict[str, EvaluationSet] | None:
    """Open a data set under both protocols; None, with the reason in ``found``, where it is not in order."""
    sets: dict[str, EvaluationSet] = {}
    try:
        for end in VARIANTS.values():
            protocol = find_protocol(f"{name}{end}")
            sets[f"{name}{end}"] = open_evaluation_set(found.data[name], name=name, protocol=protocol)
    except InputError as error:
        found.missing[name] = " ".join(str(error).split())
        return None
    first = next(iter(sets.values()))
    expected = datasets()[name].eval_samples
    if len(first.dataset) != expected:
        found.missing[name] = (
            f"{found.data[name]} has {len(first.dataset)} photos to score, the paper {expected:,}: the numbers are of "
            "other photos"
        )
    return sets


def _models_for(name: str) -> list[str]:
    domain = datasets()[name].domain.lower()
    return [model for model, (_, domains) in MODELS.items() if domain in domains]


def _differences(measured: Mapping[tuple[str, str, str], Mapping[str, float]]) -> list[Difference]:
    rows = []
    for name in datasets():
        printed = dict(method_rows(name))
        for model in _models_for(name):
            label = MODELS[model][0]
            for metric in _METRICS:
                if metric not in printed.get(label, {}):
                    continue
                values = {v: measured[model, name, v][metric] for v in VARIANTS if (model, name, v) in measured}
                rows.append(Difference(label, name, metric, printed[label][metric], values))
    return rows


def difference_table(rows: Iterable[Difference]) -> ReportTable:
    """Set the numbers in a table: as printed, as measured under each protocol, and what they differ by."""
    header = ("model", "data", "metric", "printed", "paper's protocol", "difference", "released protocol", "difference")
    lines = []
    for row in rows:
        cells: list[str] = []
        for variant in VARIANTS:
            value = row.measured.get(variant)
            cells += [NOT_RUN, "-"] if value is None else [f"{value:.4f}", f"{value - float(row.printed):+.4f}"]
        lines.append((row.model, row.data, HEADINGS[row.metric], str(row.printed), *cells))
    return ReportTable(TITLE, header, tuple(lines))
