"""The time to start, in a fresh process each time."""

import subprocess
import sys

from benchmarks.timing import compare


def main() -> None:
    """Time ``zoedepth --help`` and ``import zoedepth`` beside their floors: the interpreter and ``import torch``."""

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
