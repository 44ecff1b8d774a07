"""Bring the maps of zoed-lite's decoder back to an ordinary size, and give it new heads.

    python scripts/rescale_decoder.py MODEL OUT --photos nyu/image/00028.jpg kitti/image/s000105.jpg

Nothing in a DPT decoder bounds its maps: stage 1 does not see their scale, and thousands of steps let it grow from 10
to 100,000, until the maps of the encoder that are added on the way drown in it, and whatever a head makes of them is at
its bounds. The levels get a standard deviation of ``SIZE``, and the last map and relative depth half of it; each added
map keeps its share. Encoder, router and the map at the bottleneck stay; what the heads make of levels starts anew.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from zoedepth import load_model, save_model
from zoedepth.build import build_model
from zoedepth.errors import InputError
from zoedepth.images import read_image
from zoedepth.model.zoedepth import ZoeDepth, normalize
from zoedepth.presets import ZOED_LITE
from zoedepth.sizes import network_size

SIZE = 10.0
"""Standard deviation of the levels afterwards."""


def main(model: str, out: Path, *, photos: tuple[Path, ...], seed: int = 0) -> None:
    """Write the model with another decoder and new heads.

    Args:
        model: the model whose decoder has grown.
        out: the file to write.
        photos: photos whose maps are measured.
        seed: of the new heads.
    """
    torch.manual_seed(seed)
    old, new = load_model(model), build_model(ZOED_LITE).eval()
    if not isinstance(old, ZoeDepth) or not isinstance(new, ZoeDepth):
        raise InputError(f"{model} is no ZoeDepth, so it has no such decoder")
    with torch.no_grad():
        rescale(old, [_pixels(path) for path in photos])
    kept = ("encoder.", "decoder.", "router.", "shared.bottleneck.")
    weights = {key: value for key, value in old.state_dict().items() if key.startswith(kept)}
    new.load_state_dict({**new.state_dict(), **weights})
    new.provenance = old.provenance
    save_model(new, out)


def rescale(model: ZoeDepth, photos: list[Tensor]) -> None:
    """Change the decoder's weights, so that its maps of these photos have the sizes above."""
    decoder, found = model.decoder, [model.relative_features(pixels) for pixels in photos]
    maps = [model.encoder(normalize(pixels)).maps for pixels in photos]
    factor = 1.0  # of the map that comes into a block
    for level, block in enumerate(decoder.fusion):
        project: Any = decoder.project[3 - level]
        fusion: Any = block
        if fusion.skip is not None:
            added = [project(each[3 - level]) for each in maps]
            # What the residual unit computes keeps its share; what it passes on as it is becomes as large.
            passed = factor * _size([fusion.skip(each) for each in added]) / _size(added)
            project.weight.mul_(passed)
            fusion.skip.conv1.bias.mul_(passed)
            fusion.skip.conv2.weight.mul_(factor / passed)
            fusion.skip.conv2.bias.mul_(factor)
        fusion.refine.conv1.bias.mul_(factor)
        fusion.refine.conv2.bias.mul_(factor)
        wanted = SIZE / _size([each.levels[level] for each in found])
        fusion.project.weight.mul_(wanted / factor)
        fusion.project.bias.mul_(wanted)
        factor = wanted
    head = decoder.relative_head
    for conv, size in (
        (head.conv1, None),
        (head.conv2, _size([each.last for each in found])),
        (head.conv3, _size([each.relative for each in found])),
    ):
        wanted = factor if size is None else SIZE / 2 / size
        conv.weight.mul_(wanted / factor)
        conv.bias.mul_(wanted)
        factor = wanted


def _size(maps: list[Tensor]) -> float:
    """Return the standard deviation of a map, the mean over the photos."""
    return float(np.mean([each.std().item() for each in maps]))


def _pixels(path: Path) -> Tensor:
    """Return a photo as the network sees it."""
    image = read_image(path)
    size = network_size(image.shape[:2], ZOED_LITE.size, multiple=ZOED_LITE.multiple, keep_aspect_ratio=True)
    pixels = torch.from_numpy(image.copy()).permute(2, 0, 1)[None].float() / 255
    return F.interpolate(pixels, size, mode="bilinear", antialias=True)


if __name__ == "__main__":
    tyro.cli(main)
