"""A folder as ``zoedepth verify`` is given it, tiny: weights of one model, and photos that stand for NYU."""

import dataclasses
from pathlib import Path

from tests.folders import write_pairs

from zoedepth.config import ModelConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.save import save_model


def write_released(folder: Path, tiny: ModelConfig) -> None:
    """Write the weights as those of ZoeD-M12-N, and two photos to score."""
    model = ZoeDepth(dataclasses.replace(tiny, domains=tiny.domains[:1])).eval()
    (folder / "weights").mkdir(parents=True)
    save_model(model, folder / "weights" / "zoed-m12-n.safetensors")
    write_pairs(folder / "nyu", n=2, size=(480, 640), split="test")
