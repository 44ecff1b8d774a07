"""3D Movies: frames of films, in the layout that the authors' scripts make."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.stored import read_mask, read_png, read_png_with_text

_MAX_UNCERTAINTY = 20
"""The authors' threshold, 2 pixels, in the unit of the files."""


class Movies3D(PublishedDataset):
    """Frames of 3-D films; disparity by optical flow, signed, at half the frames' size. The camera is unknown.

    Only lists and scripts can be downloaded: buy the films, then extract frames and make disparity with the scripts.
    Films that a list names and that you do not have are left out. The sky, where it is known, has the least disparity
    of its frame. The authors find it with any segmentation network and do not say where to put the masks, so the folder
    ``sky`` is our choice.
    """

    about = About(
        title="3D Movies",
        page="https://github.com/lasinger/3DVideos2Stereo",
        licence="scripts MIT; the films must be bought",
        kind="disparity",
        domain="",
        layout="""
lists/train.txt, validation.txt, test.txt                 (from the page; split "val": validation.txt)
image_left/exodus/chapter2/out00000005.jpg                (by run_extractFrames.sh)
disparity/exodus/chapter2/out00000005.png                 (by get_disp_and_uncertainty.py)
uncertainty/exodus/chapter2/out00000005.png               (likewise)
sky/exodus/chapter2/out00000005.png                       (optional, not 0 is sky, of the frame's or half its size)
""",
        unit="16-bit PNG, disparity = offset + scale * value (its text chunks), pixels; unknown where uncertainty, "
        "8-bit PNG in 0.1 pixels, is above 2",
        splits={"train": 75074, "val": 3058, "test": 788},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        name = f"lists/{'validation' if self.split == 'val' else self.split}.txt"
        listed = [row[0] for row in self.lines(name, origin="from github.com/lasinger/3DVideos2Stereo")]
        films = {path.name for path in self.find("image_left/*")}
        # read_target relies on this order.
        masks = ("uncertainty", "sky") if (self.root / "sky").is_dir() else ("uncertainty",)
        return [
            PairFiles(
                self.inside(f"image_left/{frame}.jpg"),
                self.inside(f"disparity/{frame}.png"),
                masks=tuple(self.inside(f"{folder}/{frame}.png") for folder in masks),
            )
            for frame in listed
            if frame.split("/")[0] in films
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored, text = read_png_with_text(pair.target)
        try:
            offset, scale = float(text["offset"]), float(text["scale"])
        except (KeyError, ValueError) as error:
            raise InputError(
                f"{pair.target} needs the text chunks 'offset' and 'scale' with numbers: make it with the script"
            ) from error
        if not (math.isfinite(offset) and math.isfinite(scale) and scale > 0):
            raise InputError(f"{pair.target} has offset {offset} and scale {scale}: they must be finite, and scale > 0")
        disparity, known = (offset + scale * stored).astype(np.float32), np.ones(stored.shape, bool)
        for path in pair.masks[:1]:
            known = _fitting(read_png(path) <= _MAX_UNCERTAINTY, path, stored.shape)
        for path in pair.masks[1:]:
            sky = read_mask(path).values
            if sky.shape == (2 * stored.shape[0], 2 * stored.shape[1]):
                sky = sky[::2, ::2]
            sky = _fitting(sky, path, stored.shape)
            if known.any():
                disparity[sky] = disparity[known].min()
                known = known | sky
        return disparity, known


def _fitting(mask: np.ndarray, path: Path, size: tuple[int, ...]) -> np.ndarray:
    if mask.shape != size:
        raise InputError(f"{path} is {mask.shape} and its disparity is {size}: sizes must agree")
    return mask
