"""Write the report of an evaluation: tables for paper and web, pictures of example images, plots of error by depth."""

from collections.abc import Mapping, Sequence
from html import escape
from itertools import cycle, pairwise
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from zoedepth import __version__
from zoedepth.alignment import resize_depth
from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import MissingExtraError
from zoedepth.evaluation.pixels import spread_values
from zoedepth.evaluation.predictions import PredictionSource, predict
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import RANGES, Score, aligned_depth, scored_pixels
from zoedepth.evaluation.summary import Summary
from zoedepth.evaluation.tables import ReportTable
from zoedepth.images import OWN_MARK, ImageArray, atomic_path, to_image, write_image
from zoedepth.stored import readable, to_json

ERROR_LIMIT = 50.0
"""Error, in percent of the true depth, at which the scale of colours ends on both sides."""

_MIN_WIDTH = 300  # pixels of a picture: a caption is as long
_DODGE = 0.08  # distance of two curves in a plot; ranges are 1 apart
_LINES = ("-", (0, (6, 6)), (0, (2, 4)), (0, (8, 3, 2, 3)))  # lines without gaps, with long, short and both gaps


def write_report(
    folder: Path,
    summaries: Sequence[Summary],
    tables: Sequence[ReportTable],
    *,
    command: str,
    pictures: Mapping[str, Sequence[tuple[str, Path]]],
) -> None:
    """Write ``report.md``, ``report.html``, ``report.tex`` and ``report.json``, each whole or not at all.

    Args:
        folder: where the scores and pictures of the evaluation are.
        summaries: one for each source on each data set.
        tables: the result of ``tables.report_tables``.
        command: how the evaluation was started; the report quotes it. It may be empty.
        pictures: data set → (caption, file in the folder).
    """
    parts = ["# Evaluation", f"zoedepth {__version__}"]
    if command:
        parts[1:] = [f"zoedepth {__version__}:", f"```bash\n{command}\n```"]
    page = [f"<p>zoedepth {__version__}</p>", f"<pre>{escape(command)}</pre>" if command else ""]
    for data in dict.fromkeys(summary.data for summary in summaries):
        parts.append(f"## {data}")
        page.append(f"<h2>{escape(data)}</h2>")
        mine = [table for table in tables if table.data == data]
        parts += [table.markdown() for table in mine]
        page += [table.html() for table in mine]
        notes = [
            f"{s.source}: {s.n_images - s.n_scored} images without a known pixel under the protocol, "
            f"{s.n_failed} that failed; neither is in a mean."
            for s in summaries
            if s.data == data and (s.n_scored < s.n_images or s.n_failed)
        ]
        parts += notes
        page += [f"<p>{escape(note)}</p>" for note in notes]
        for caption, path in pictures.get(data, ()):
            link = quote(path.relative_to(folder).as_posix())
            parts += [f"*{caption}*", f"![{caption}]({link})"]
            page.append(
                f'<figure><figcaption>{escape(caption)}</figcaption><img src="{link}" alt="{escape(caption)}"></figure>'
            )
    of_all = [table for table in tables if not table.data]
    if of_all:
        parts += ["## All data", *(table.markdown() for table in of_all)]
        page += ["<h2>All data</h2>", *(table.html() for table in of_all)]
    _write(folder / "report.md", "\n\n".join(parts) + "\n")
    _write(folder / "report.html", _PAGE.replace("BODY", "\n".join(filter(None, page))))
    _write(folder / "report.tex", "\n".join(table.latex() for table in tables))
    values = {"zoedepth": __version__, "command": command, "results": [summary.to_json() for summary in summaries]}
    _write(folder / "report.json", to_json(values, indent=2) + "\n")


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Evaluation</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h2 { margin-top: 3rem; border-bottom: 1px solid #ccc }
pre { background: #f4f4f4; padding: .6rem; overflow-x: auto }
.table { overflow-x: auto; margin: 1.5rem 0 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
caption { text-align: left; font-weight: 600; padding: .3rem .6rem; white-space: nowrap }
th, td { padding: .25rem .6rem; text-align: right; white-space: nowrap; border-bottom: 1px solid #e4e4e4 }
th:first-child, td:first-child { text-align: left }
thead th { border-bottom: 2px solid #888 }
td.best { font-weight: 700 }
figure { margin: 1.5rem 0 }
figcaption { font-weight: 600; margin-bottom: .3rem }
img { max-width: 100%; height: auto }
</style>
</head>
<body>
<h1>Evaluation</h1>
BODY
</body>
</html>
"""


def examples(
    source: PredictionSource, data: Samples, scores: Mapping[int, Score], protocols: Mapping[str, Protocol]
) -> ImageArray | None:
    """Show best, median and worst image by REL: photo, truth, prediction, error. All depths share a scale of colours.

    Args:
        source: predicts the chosen photos again.
        data: photos with depth.
        scores: number of the image in the data → its score.
        protocols: domain → protocol.

    Returns:
        None where nothing was scored.
    """
    rel = {i: score.sums.metrics().rel for i, score in scores.items() if score.sums is not None}
    ranked = sorted(rel, key=rel.__getitem__)
    if not ranked:
        return None
    chosen = dict.fromkeys((ranked[0], ranked[len(ranked) // 2], ranked[-1]))
    ranks = ("best", "median", "worst") if len(chosen) == 3 else ("",) * len(chosen)
    shown = [
        _example(source, data[index], protocols, f"{rank}: REL {rel[index]:.3f}" if rank else f"REL {rel[index]:.3f}")
        for rank, index in zip(ranks, chosen, strict=True)
    ]
    known = np.concatenate([example.truth[example.scored] for example in shown])
    vmin, vmax = depth_range(known, percentiles=(1.0, 99.0))
    return sheet([row for example in shown for row in _panels(example, vmin=vmin, vmax=vmax)])


class _Example(NamedTuple):
    """An image that is shown: arrays of (height, width), depths in metres."""

    caption: str
    sample: Sample
    truth: np.ndarray
    scored: np.ndarray
    depth: np.ndarray


def _example(source: PredictionSource, sample: Sample, protocols: Mapping[str, Protocol], caption: str) -> _Example:
    protocol = protocols[sample.domain]
    prediction, cropped = predict(source, sample, protocol)
    truth, scored = cropped.target[0].numpy(), scored_pixels(cropped, protocol)
    return _Example(caption, cropped, truth, scored, aligned_depth(prediction, truth, scored, protocol))


def _panels(example: _Example, *, vmin: float, vmax: float) -> list[list[ImageArray]]:
    """Return rows of panels: all four in a row, or two rows of two where the photo is as wide as KITTI's."""
    truth, scored = example.truth, example.scored
    wide = truth.shape[1] > 2 * truth.shape[0]
    width = min(truth.shape[1], 720 if wide else 400)
    height = round(truth.shape[0] * width / truth.shape[1])
    size = (height, width)
    error = np.where(scored, 100 * (example.depth / np.where(scored, truth, 1) - 1), np.nan)
    known = np.where(example.sample.mask[0].numpy(), truth, np.nan)
    factor = -(-_MIN_WIDTH // width)  # small photos are enlarged, so that captions have room
    frame = (factor * height, factor * width)
    depth_bar = color_bar(frame[0], vmin=vmin, vmax=vmax)
    error_bar = color_bar(frame[0], vmin=-ERROR_LIMIT, vmax=ERROR_LIMIT, colormap="Spectral_r", unit="%")
    predicted = colorize(resize_depth(example.depth, size), vmin=vmin, vmax=vmax)
    measured = colorize(spread_values(known, size), vmin=vmin, vmax=vmax)
    four = [
        panel(to_image(example.sample.image), size=frame, caption=f"{example.caption}, {example.sample.name}"[:48]),
        panel(measured, size=frame, caption="measured (grey: unknown)"),
        panel(predicted, size=frame, bar=depth_bar, caption="predicted"),
        panel(_colored_error(spread_values(error, size)), size=frame, bar=error_bar, caption="error (red: too far)"),
    ]
    return [[four[0], four[2]], [four[1], four[3]]] if wide else [four]


def require_matplotlib() -> None:
    """Check that plots can be made.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401 - only to see whether it is there
    except ImportError as error:
        raise MissingExtraError("report", "an evaluation report with pictures") from error


def error_by_depth(summaries: Sequence[Summary], path: Path) -> None:
    """Plot REL against true depth for all sources on one data set, above the share of pixels at each depth.

    Args:
        summaries: one for each source.
        path: PNG to write.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    names = [f"{low:g}-{high:g}" for low, high in pairwise(RANGES)]
    names = [name for name in names if any(name in summary.ranges for summary in summaries)]
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    positions = np.arange(len(names))
    # Equal curves are all seen: their points lie side by side, and the gaps of a line show those below it.
    shifts = _DODGE * (np.arange(len(summaries)) - (len(summaries) - 1) / 2)
    for summary, shift, style in zip(summaries, shifts, cycle(_LINES), strict=False):
        values = [summary.ranges[name]["rel"] if name in summary.ranges else np.nan for name in names]
        top.plot(positions + shift, values, marker="o", markersize=4, linestyle=style, label=summary.source)
    top.set_ylabel("REL, pooled over pixels")
    top.set_ylim(bottom=0)
    top.grid(alpha=0.3)
    top.legend(fontsize=8, frameon=False)
    shares = next((summary.ranges for summary in summaries if summary.ranges), {})
    bottom.bar(positions, [100 * shares.get(name, {"share": 0})["share"] for name in names], color="0.6")
    bottom.set_ylabel("pixels, %")
    bottom.set_xlabel("true depth, metres")
    bottom.set_xticks(positions, names)
    with atomic_path(path) as part:
        figure.savefig(part, dpi=150, format="png", metadata={"Software": OWN_MARK})


def write_picture(path: Path, picture: ImageArray) -> None:
    """Write a sheet of pictures as a PNG, whole or not at all."""
    write_image(path, picture)


def _colored_error(error: np.ndarray) -> ImageArray:
    # colorize shows values that are not positive as unknown, so errors are shifted: no error is the middle colour.
    shifted = np.where(np.isfinite(error), error.clip(-ERROR_LIMIT, ERROR_LIMIT) + ERROR_LIMIT + 1, 0)
    return colorize(shifted, vmin=1.0, vmax=2 * ERROR_LIMIT + 1, colormap="Spectral_r")


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as part:
        part.write_text(readable(text), encoding="utf-8")
