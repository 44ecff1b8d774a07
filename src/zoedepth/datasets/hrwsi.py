"""HR-WSI: stereo photos of the web, in the layout of its archive."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.stored import read_mask, read_png


class HRWSI(PublishedDataset):
    """Stereo photos of all kinds from the web; disparity by optical flow, up to scale and shift. The camera is unknown.

    The masks say where the forward and the backward flow agree. The instance masks are not needed.
    """

    about = About(
        title="HR-WSI",
        page="https://kexianhust.github.io/Structure-Guided-Ranking-Loss/",
        licence="non-commercial, research",
        kind="disparity",
        domain="",
        layout="""
train/imgs/<name>.jpg             (split "val": val/)
train/gts/<name>.png
train/valid_masks/<name>.png
""",
        unit="8-bit PNG, disparity without a unit, unknown where the mask is 0",
        splits={"train": 20378, "val": 400},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        folder = self.root / self.split
        return [
            PairFiles(photo, folder / f"gts/{photo.stem}.png", masks=(folder / f"valid_masks/{photo.stem}.png",))
            for photo in self.find(f"{self.split}/imgs/*.jpg")
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        disparity, known = read_png(pair.target).astype(np.float32), read_mask(pair.masks[0]).values
        if known.shape != disparity.shape:
            raise InputError(
                f"{pair.masks[0]} is {known.shape} and {pair.target} is {disparity.shape}: sizes must agree"
            )
        return disparity, known
