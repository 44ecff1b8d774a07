"""A user's cache of its own for each test, a small model in a file, and a machine that is the same everywhere."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.runtimes.machine import Machine
from zoedepth.weights.save import save_model


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache, which is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "zoedepth"


@pytest.fixture(autouse=True)
def able_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A processor on which all rows can be measured, whichever runs the tests."""
    monkeypatch.setattr("zoedepth.runtimes.runtime.has_bfloat16", lambda: True)
    monkeypatch.setattr("zoedepth.runtimes.runtime.adds_8_bits_exactly", lambda: True)
    monkeypatch.setattr("zoedepth.runtimes.benchmark.products", lambda machine: {"float32": 1.0, "bfloat16": 2.0})


@pytest.fixture
def weights(tmp_path: Path, tiny_model: ZoeDepth) -> Path:
    """The tiny model in a file."""
    path = tmp_path / "tiny.safetensors"
    save_model(tiny_model, path)
    return path


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    """Two small photos of two sizes."""
    paths = [tmp_path / "photos" / f"{number}.png" for number in range(2)]
    paths[0].parent.mkdir()
    for number, path in enumerate(paths):
        noise = np.random.default_rng(number).integers(0, 256, (40, 50 + 10 * number, 3), dtype=np.uint8)
        Image.fromarray(noise).save(path)
    return paths


@pytest.fixture
def machine() -> Machine:
    """A machine without a GPU."""
    return Machine("A processor", "0f", 2, None)
