"""``zoedepth demo``: predict real photographs, one of them with measured depth."""

from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.errors import MissingExtraError
from zoedepth.folders import check_writable
from zoedepth.geometry.camera import Camera
from zoedepth.images import DepthArray, ImageArray, write_image
from zoedepth.metrics import compute_metrics
from zoedepth.outputs.html import write_page_of_maps
from zoedepth.outputs.ownership import require_own_mark

if TYPE_CHECKING:
    from zoedepth.depth_map import DepthMap

NAMES, ENDINGS = ("motorcycle", "rocket", "coffee"), ("_depth.png", "_preview.jpg")
"""The photographs, and the files of each."""
SHEET, PAGE = "demo.png", "coffee.html"
"""All photographs on one sheet, and one of them in three dimensions."""

# The camera of the photo at the size scikit-image ships it (docstring of skimage.data.stereo_motorcycle).
FOCAL_PX = 994.978
BASELINE = 0.193001
"""Metres."""
PRINCIPAL_POINT_SHIFT_PX = 31.086
"""Column of the right camera's principal point minus the left's, added to each disparity."""


def demo(*, out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo"), model: str = "zoed-lite") -> int:
    """Predict the depth of three photographs, compare one with its measured depth, and show one in the browser.

    The photographs come with scikit-image; nothing is downloaded.

    Args:
        out: folder to write to.
        model: a name of `zoedepth models`, or a file of weights.
    """
    check_writable(out, option="--out")
    _check_replaced(out)
    data = _skimage_data()
    photos = dict(zip(NAMES, (data.stereo_motorcycle()[0], data.rocket(), data.coffee()), strict=True))
    truth = motorcycle_depth()

    from zoedepth.commands.progress import download_progress
    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_for_prediction

    console = Console(highlight=False)
    with download_progress() as progress:
        predictor = Predictor(load_for_prediction(model, progress=progress), device="auto")
    results = {}
    for name, photo in photos.items():
        # The motorcycle's camera is known; the notes of the others are lost.
        camera = Camera.from_focal(FOCAL_PX, (photo.shape[0], photo.shape[1])) if name == "motorcycle" else None
        result = results[name] = predictor(photo, camera=camera)
        for ending in ENDINGS:
            result.save(out / f"{name}{ending}")
        near, far = np.percentile(result.depth, (1, 99))
        console.print(f"{name}: {near:.1f} to {far:.1f} m, {_domain(result)}")

    motorcycle = results["motorcycle"]
    console.print(_error_table(motorcycle.depth, truth))
    console.print(_focal_note(motorcycle), soft_wrap=True)
    write_image(out / SHEET, _contact_sheet(results, truth))
    write_page_of_maps(out / PAGE, results["coffee"].maps, title="coffee", most=100_000)
    console.print(
        f"Pictures: {out / SHEET}; the depth and preview of each photo are beside it, and {PAGE}: open that page in a "
        "browser, and turn the cup.",
        soft_wrap=True,
    )
    return 0


def _check_replaced(out: Path) -> None:
    """Refuse to replace files that this package has not written."""
    for file in (out / SHEET, out / PAGE, *(out / f"{name}{ending}" for name in NAMES for ending in ENDINGS)):
        require_own_mark(file, advice="choose another folder with --out")


def motorcycle_depth() -> DepthArray:
    """Return the measured depth of the motorcycle: metres, (500, 741), 0 where it was not measured.

    Middlebury 2014 stereo (Scharstein et al., GCPR 2014), reduced four times by scikit-image: the depth is
    focal length * baseline / (disparity + shift of the principal point), from 2.0 to 5.0 m.
    """
    _, _, disparity = _skimage_data().stereo_motorcycle()
    with np.errstate(invalid="ignore"):
        depth = FOCAL_PX * BASELINE / (disparity + PRINCIPAL_POINT_SHIFT_PX)
    return np.where(np.isfinite(disparity), depth, 0).astype(np.float32)


def _skimage_data() -> ModuleType:
    try:
        from skimage import data
    except ImportError as error:
        raise MissingExtraError("demo", "zoedepth demo") from error
    return data


def _domain(result: "DepthMap") -> str:
    return f"{result.domain} ({result.domain_probability[result.domain]:.0%})"


def _error_table(depth: DepthArray, truth: DepthArray) -> Table:
    """Return the errors where depth was measured: as predicted, and after a factor that makes the medians agree."""
    known = truth > 0
    predicted, measured = depth[known], truth[known]
    factor = float(np.median(measured) / np.median(predicted))
    table = Table(title=f"motorcycle: predicted against measured depth, {known.sum():,} pixels")
    for heading in ("depth", "REL", "RMSE", "delta1", "median ratio"):
        table.add_column(heading, justify="left" if heading == "depth" else "right")
    for label, scaled in (("in metres, as predicted", predicted), (f"times {factor:.2f}", predicted * factor)):
        metrics = compute_metrics(scaled, measured)
        ratio = np.median(scaled) / np.median(measured)
        table.add_row(label, f"{metrics.rel:.3f}", f"{metrics.rmse:.2f} m", f"{metrics.delta1:.3f}", f"{ratio:.2f}")
    return table


def _focal_note(motorcycle: "DepthMap") -> str:
    given = f"The camera of the motorcycle is known, and was given: it spans {motorcycle.camera.fov_x:.0f} degrees"
    second = "The second row judges the shape without the scale."
    if motorcycle.focal_correction == 1:
        return f"{given}. This model does not correct depth for it. {second}"
    return f"{given}, and the model's depth was multiplied by {motorcycle.focal_correction:.2f} for it. {second}"


def _contact_sheet(results: dict[str, "DepthMap"], truth: DepthArray) -> ImageArray:
    """Draw each photo beside its depth; below the motorcycle, what was measured in the same colours, and the error."""
    rows = []
    for name, result in results.items():
        measured = truth if name == "motorcycle" else None
        both = result.depth if measured is None else np.concatenate([result.depth, measured])
        vmin, vmax = depth_range(both, percentiles=(1.0, 99.0))
        rows.append([
            panel(result.image, caption=name),
            _depth_panel(result.depth, vmin, vmax, caption=f"depth, {_domain(result)}"),
        ])  # fmt: skip
        if measured is not None:
            rows.append([
                _depth_panel(measured, vmin, vmax, caption="measured depth (grey: not measured)"),
                _error_panel(result.depth, measured),
            ])  # fmt: skip
    return sheet(rows)


def _depth_panel(depth: DepthArray, vmin: float, vmax: float, *, caption: str) -> ImageArray:
    bar = color_bar(depth.shape[0], vmin=vmin, vmax=vmax)
    return panel(colorize(depth, vmin=vmin, vmax=vmax), bar=bar, caption=caption)


def _error_panel(depth: DepthArray, truth: DepthArray) -> ImageArray:
    """Draw predicted over measured depth in percent: 100 is right, blue too near, red too far."""
    percent = np.full_like(truth, np.nan)
    np.divide(100 * depth, truth, out=percent, where=truth > 0)
    bar = color_bar(truth.shape[0], vmin=50.0, vmax=150.0, colormap="Spectral_r", unit="%")
    colored = colorize(percent, vmin=50.0, vmax=150.0, colormap="Spectral_r")
    return panel(colored, bar=bar, caption="predicted / measured (blue: too near, red: too far)")
