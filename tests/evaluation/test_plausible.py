"""Doubts about depth maps in files: inverse depth, other units, and scales that nobody says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.evaluation.samples import EVERYWHERE, sample_of

from zoedepth.errors import InputError
from zoedepth.evaluation.plausible import check_predictions
from zoedepth.evaluation.predictions import FolderSource

TRUTH = np.linspace(1, 8, 600).reshape(20, 30).astype(np.float32)
SAMPLE = sample_of(np.where(TRUTH > 1.5, TRUTH, 0))
DISPARITY = replace(EVERYWHERE, alignment="disparity")


def folder_of(folder: Path, values: np.ndarray) -> Path:
    """Keep a map as the photo's: whole numbers in a PNG, others in an array."""
    if values.dtype.kind == "f":
        np.save(folder / "photo.npy", values)
    else:
        Image.fromarray(values).save(folder / "photo.png")
    return folder


@pytest.mark.parametrize("factor", [1.0, 0.3, 5.0])
def test_depth_in_metres_is_not_doubted(tmp_path: Path, factor: float) -> None:
    noise = np.random.default_rng(0).uniform(0.5, 2, TRUTH.shape)
    source = FolderSource(folder_of(tmp_path, TRUTH * factor * noise))
    assert check_predictions(source, SAMPLE, EVERYWHERE) is None


@pytest.mark.parametrize(("scale", "proposal"), [(1000, "1000 fits"), (256, "256 fits"), (5000, "5000 fits")])
def test_scale_that_nobody_says_is_proposed(tmp_path: Path, scale: int, proposal: str) -> None:
    source = FolderSource(folder_of(tmp_path, (TRUTH * scale * 1.2).astype(np.uint16)))
    with pytest.raises(InputError, match=rf"photo\.png does not say .*photo\.jpg: add --predictions-scale, {proposal}"):
        check_predictions(source, SAMPLE, EVERYWHERE)
    for protocol in (DISPARITY, replace(EVERYWHERE, alignment="median")):  # finds it
        assert check_predictions(source, SAMPLE, protocol) is None


def test_unusual_scale_is_asked_for(tmp_path: Path) -> None:
    source = FolderSource(folder_of(tmp_path, (TRUTH * 37).astype(np.uint16)))
    with pytest.raises(
        InputError, match=r"They are 36\.\d times the true depth .* --predictions-scale, give that of one metre"
    ):
        check_predictions(source, SAMPLE, EVERYWHERE)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1000, r"the median depth is 4,7\d\d m, and the true one 4\.7\d m.*--predictions-scale, .*: 1000 fits"),
        (100, r"the median depth is 47\d m, .*--predictions-scale, .*: 100 fits"),
        (0.001, r"the median depth is 0\.0047\d m, .*--predictions-scale, .*: 1 if it is right"),
    ],
    ids=["millimetres", "centimetres", "kilometres"],
)
def test_other_unit_is_named_unless_told(tmp_path: Path, factor: float, message: str) -> None:
    folder = folder_of(tmp_path, TRUTH * factor)
    with pytest.raises(InputError, match=message):
        check_predictions(FolderSource(folder), SAMPLE, EVERYWHERE)
    assert check_predictions(FolderSource(folder, scale=factor), SAMPLE, EVERYWHERE) is None
    odd = check_predictions(FolderSource(folder, scale=1), SAMPLE, EVERYWHERE)
    assert odd is not None
    assert "the true one 4.7" in odd


@pytest.mark.parametrize("alignment", ["none", "median", "disparity"])
@pytest.mark.parametrize("kind", [np.float32, np.uint16])
def test_inverse_depth_that_is_taken_for_depth_is_named(tmp_path: Path, alignment: str, kind: type) -> None:
    protocol = replace(EVERYWHERE, alignment=alignment)
    folder = folder_of(tmp_path, (1000 / TRUTH - 50).astype(kind))
    with pytest.raises(InputError, match=r"photo\.\w+ is large where photo\.jpg is near.*--predictions-kind disparity"):
        check_predictions(FolderSource(folder), SAMPLE, protocol)
    assert check_predictions(FolderSource(folder, scale=100, kind="depth"), SAMPLE, protocol) is None
    assert check_predictions(FolderSource(folder, kind="disparity"), SAMPLE, DISPARITY) is None


def test_disparity_must_be_aligned(tmp_path: Path) -> None:
    source = FolderSource(folder_of(tmp_path, 1 / TRUTH), kind="disparity")
    with pytest.raises(InputError, match="--align disparity"):
        check_predictions(source, SAMPLE, EVERYWHERE)


@pytest.mark.parametrize("values", [np.zeros_like(TRUTH), np.full_like(TRUTH, np.nan), np.full_like(TRUTH, 2)])
def test_map_that_tells_nothing_is_not_doubted(tmp_path: Path, values: np.ndarray) -> None:
    assert check_predictions(FolderSource(folder_of(tmp_path, values)), SAMPLE, EVERYWHERE) is None


def test_missing_and_damaged_maps_are_left_to_fail(tmp_path: Path) -> None:
    assert check_predictions(FolderSource(tmp_path), SAMPLE, EVERYWHERE) is None
    (tmp_path / "photo.npy").write_bytes(b"no array")
    assert check_predictions(FolderSource(tmp_path), SAMPLE, EVERYWHERE) is None
