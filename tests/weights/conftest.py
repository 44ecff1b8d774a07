"""A file of weights, for all tests of this folder."""

from pathlib import Path

import pytest

from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.save import save_model


@pytest.fixture
def file(tiny_model: ZoeDepth, tmp_path: Path) -> Path:
    """Write the tiny model to a file in its own layout."""
    save_model(tiny_model, tmp_path / "model.safetensors")
    return tmp_path / "model.safetensors"
