import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import zoedepth
from zoedepth.predict import Predictor
from zoedepth.weights.load import load_model

TORCH = {"torch"}
LATER = {
    "timm", "torchvision", "lightning", "lightning_fabric", "tensorboard", "matplotlib", "skimage", "scipy", "gradio",
    "fastapi", "uvicorn", "onnx", "onnxruntime", "openvino", "transformers", "cv2", "beartype", "huggingface_hub",
}  # fmt: skip
"""What costs time to import and is not needed until something is used."""


CHEAP = [
    "import zoedepth",
    "zoedepth.ModelConfig, zoedepth.InputError, dir(zoedepth)",
    "import zoedepth.config, zoedepth.presets, zoedepth.recipes, zoedepth.errors, zoedepth.sizes",
    "import zoedepth.cli",
    "assert zoedepth.cli.main(['--help']) == 0",
    "assert zoedepth.cli.main(['--version']) == 0",
    "import zoedepth.commands.predict, zoedepth.commands.benchmark, zoedepth.runtimes.fast",
    "from zoedepth import Predictor, load_model",
    "from zoedepth.weights import hub; hub.is_hub_id('zoed-lite')",
]
"""Code that costs nothing, and what needs torch behind it. One process runs all of it: to start one takes longer."""
WITH_TORCH = "from zoedepth import ZoeDepth"


def modules_after(codes: list[str]) -> list[set[str]]:
    """Return the top-level modules that a fresh interpreter holds after running each code in turn."""
    lines = ["import contextlib, io, sys"]
    for code in codes:
        lines += ["with contextlib.redirect_stdout(io.StringIO()):", f"    {code}"]
        lines += ["print(*sorted({name.partition('.')[0] for name in sys.modules}))"]
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=True)
    return [set(line.split()) for line in done.stdout.splitlines()]


def test_imports_and_help_are_cheap_and_the_model_needs_torch_but_not_what_is_used_later():
    *cheap, last = modules_after([*CHEAP, WITH_TORCH])
    heavy = {code: found & (TORCH | LATER) for code, found in zip(CHEAP, cheap, strict=True)}
    assert heavy == {code: set() for code in CHEAP}
    assert last & (TORCH | LATER) == TORCH


WITHOUT_TORCH = """
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        assert name.partition(".")[0] not in ("torch", "timm", "torchvision"), f"{name} is imported"

sys.meta_path.insert(0, Refused())
from zoedepth.cli import main

sys.exit(main(sys.argv[1:]))
"""


def test_the_model_in_the_package_predicts_without_torch_what_torch_predicts(tmp_path: Path):
    photo = tmp_path / "photo.png"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (70, 90, 3), np.uint8)).save(photo)
    command = ["predict", str(photo), "--out", str(tmp_path), "--save", "npy", "--device", "cpu"]
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    expected = Predictor(load_model("zoed-lite"))(photo).depth
    np.testing.assert_allclose(np.load(tmp_path / "photo_depth.npy"), expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", zoedepth.__all__)
def test_public_names_are_there_and_listed(name: str):
    assert getattr(zoedepth, name).__name__ == name
    assert name in dir(zoedepth)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"zoedepth.*ZoeDeep"):
        zoedepth.ZoeDeep  # noqa: B018 - to look is what raises


def test_version_is_the_installed_one():
    assert zoedepth.__version__ == version("zoedepth")
