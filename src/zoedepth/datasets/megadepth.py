"""MegaDepth v1: landmarks, in the layout of its archive."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.images import PICTURE_SUFFIXES
from zoedepth.stored import read_hdf5

_FOLDERS = ("phoenix/S6/zl548/MegaDepth_v1", "MegaDepth_v1", ".")
_PERCENTILES = (1, 98)
_MIN_POSITIVE = 10


class MegaDepth(PublishedDataset):
    """Tourists' photos of landmarks with depth by structure from motion. The camera is not in the archive.

    The depth of each scene has a scale of its own, so the target is disparity: 1 / depth. It is known for the depths
    between the 1st and the 98th percentile, as the authors train. Some files hold no depth but labels that say which
    region is nearer, in whole numbers, some negative: nothing is known for these pairs. The official test lists are
    pickles and are not read.

    The licence is that of the data, as others state it; the authors' code is MIT.
    """

    about = About(
        title="MegaDepth v1",
        page="https://www.cs.cornell.edu/projects/megadepth/",
        licence="CC BY 4.0",
        kind="disparity",
        domain="",
        layout="""
MegaDepth_v1/0000/dense0/imgs/<name>.jpg      (the archive has it in phoenix/S6/zl548/, which may stay)
MegaDepth_v1/0000/dense0/depths/<name>.h5
""",
        unit="HDF5 'depth', up to a scale of each scene, 0 unknown; whole numbers are labels",
        splits={"train": None},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        base = next(folder for folder in _FOLDERS if (self.root / folder).is_dir())
        return [
            PairFiles(photo, photo.parents[1] / "depths" / f"{photo.stem}.h5")
            for photo in self.find(f"{base}/*/dense*/imgs/*")
            if photo.suffix.lower() in PICTURE_SUFFIXES
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_hdf5(pair.target, "depth").astype(np.float32)
        positive = depth[np.isfinite(depth) & (depth > 0)]
        labels = (depth < 0).any() or (positive == np.rint(positive)).all()
        if labels or len(positive) <= _MIN_POSITIVE:
            return np.zeros_like(depth), np.zeros(depth.shape, bool)
        low, high = np.percentile(positive, _PERCENTILES)
        known = (depth >= low) & (depth <= high)
        return 1 / np.where(known, depth, 1), known
