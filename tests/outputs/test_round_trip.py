"""Every format of depth gives back what was written, within its rounding, whatever the size and the range."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from zoedepth.images import PNG_MAX
from zoedepth.outputs import OUTPUTS, Maps, Options, write_maps
from zoedepth.stored import DEPTH_SUFFIXES, read_depth

SUFFIXES = sorted({suffix for output in OUTPUTS.values() for suffix in output.suffixes} & set(DEPTH_SUFFIXES))
EXACT = [suffix for suffix in SUFFIXES if suffix != ".png"]

METRES = st.floats(-5, 3).map(lambda power: float(np.float32(10**power)))
"""From a hundredth of a millimetre to a kilometre."""
NOT_KNOWN = st.sampled_from([0.0, -1.0, np.nan, np.inf, -np.inf])
SIZES = st.tuples(st.integers(1, 20), st.integers(1, 20)) | st.sampled_from([(1, 1), (1, 300), (300, 1)])
MAPS = SIZES.flatmap(lambda size: arrays(np.float32, size, elements=METRES | NOT_KNOWN))

needs_its_library = pytest.mark.parametrize("suffix", EXACT)


def known(depth: np.ndarray) -> np.ndarray:
    return np.isfinite(depth) & (depth > 0)


def skip_without_library(suffix: str) -> None:
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")


def test_every_format_of_depth_is_here() -> None:
    assert {".png", ".npy", ".npz", ".exr", ".tif", ".tiff", ".pfm"} == set(SUFFIXES)


@needs_its_library
@given(depth=MAPS)
@settings(max_examples=30)
def test_floats_come_back_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, suffix: str, depth) -> None:
    skip_without_library(suffix)
    path = tmp_path_factory.getbasetemp() / f"depth{suffix}"
    assert write_maps(path, Maps(depth=depth)).notes == ()
    np.testing.assert_array_equal(read_depth(path), np.where(known(depth), depth, 0))


@given(depth=MAPS, scale=st.sampled_from([None, 1000.0, 256.0]) | st.floats(0.01, 1e6))
@settings(max_examples=60)
def test_levels_come_back_within_half_of_one_and_what_does_not_fit_is_said(
    tmp_path_factory: pytest.TempPathFactory, depth, scale: float | None
) -> None:
    path = tmp_path_factory.getbasetemp() / "depth.png"
    written = write_maps(path, Maps(depth=depth), Options(png_scale=scale))
    used = written.facts["png_scale"]
    assert isinstance(used, float)
    assert scale is None or used == scale
    found = read_depth(path)
    valid = known(depth)
    assert (found[~valid] == 0).all()
    levels = depth[valid].astype(np.float64) * used
    rounding = 0.5 / used * (1 + 1e-6) + 1e-6 * depth[valid]  # and that of float32
    assert (np.abs(found[valid] - levels.clip(1, PNG_MAX) / used) <= rounding).all()
    assert any("too far" in note for note in written.notes) == bool((levels > PNG_MAX + 0.5).any())
    assert any("too near" in note for note in written.notes) == bool((levels <= 0.5).any())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_of_most_of_a_megapixel(tmp_path: Path, suffix: str) -> None:
    skip_without_library(suffix)
    rng = np.random.default_rng(0)
    depth = np.exp(rng.uniform(np.log(0.5), np.log(60), (751, 999))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0
    path = tmp_path / f"depth{suffix}"
    write_maps(path, Maps(depth=depth))
    np.testing.assert_allclose(read_depth(path), depth, rtol=0, atol=5.01e-4 if suffix == ".png" else 0)
