"""The time to start, in a fresh process each time."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.timing import compare
from zoedepth.weights.releases import RELEASES


def main() -> None:
    """Time ``zoedepth --help``, ``import zoedepth`` and one photo beside their floors: Python and ``import torch``."""

    def process(*arguments: str):
        return lambda: subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)

    compare("start of the command line", {
        "python -c pass": process("-c", "pass"),
        "zoedepth --help": process("-m", "zoedepth", "--help"),
    })  # fmt: skip
    compare("import", {
        "import torch": process("-c", "import torch"),
        "import torch, zoedepth": process("-c", "import torch, zoedepth"),
        "from zoedepth import Predictor, load_model": process("-c", "from zoedepth import Predictor, load_model"),
        "load_model('zoed-lite')": process("-c", "import zoedepth; zoedepth.load_model('zoed-lite')"),
    }, runs=3, warmup=1)  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        photo = folder / "photo.jpg"
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)).save(photo)

        def predict(model: str | Path):
            arguments = ("--model", str(model), "--out", str(folder / "depth"), "--no-preview", "--overwrite")
            return process("-m", "zoedepth", "predict", str(photo), "--json", *arguments)

        compare("one photo, from the command to the files", {
            "import torch": process("-c", "import torch"),
            "zoedepth predict": predict("zoed-lite"),
            "zoedepth predict, with torch": predict(RELEASES["zoed-lite"].path),
        }, runs=5, warmup=1)  # fmt: skip
