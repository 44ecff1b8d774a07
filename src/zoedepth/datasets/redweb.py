"""ReDWeb: stereo photos of the web, in the layout of its archive."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.images import read_image


class ReDWeb(PublishedDataset):
    """Stereo photos of all kinds from the web; disparity by optical flow, up to scale and shift. The camera is unknown.

    The stored values grow with distance and are linear in disparity, so disparity is 1 - value / 255. The sky, which
    the authors marked with 255, then has the least disparity, 0, and is known. (Others negate the values and set the
    sky to 0, which puts it nearest of all.)
    """

    about = About(
        title="ReDWeb",
        page="https://sites.google.com/site/redwebcvpr18/",
        licence="custom, research",
        kind="disparity",
        domain="",
        layout="""
ReDWeb_V1/Imgs/<name>.jpg      (or the folder ReDWeb_V1 itself)
ReDWeb_V1/RDs/<name>.png
""",
        unit="8-bit PNG, disparity = 1 - value / 255 without a unit, 255 is sky, all known",
        splits={"train": 3600},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        base = "ReDWeb_V1" if (self.root / "ReDWeb_V1").is_dir() else "."
        return [
            PairFiles(photo, self.root / base / f"RDs/{photo.stem}.png") for photo in self.find(f"{base}/Imgs/*.jpg")
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        # A photo's reader, because it is not documented whether the grey is stored once or three times.
        stored = read_image(pair.target, photo=False)[..., 0]
        return 1 - stored.astype(np.float32) / 255, np.ones(stored.shape, bool)
