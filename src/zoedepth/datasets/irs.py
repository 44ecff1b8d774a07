"""IRS: rendered rooms for indoor robots, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_exr


class IRS(PublishedDataset):
    """Rendered homes, offices, restaurants and stores, left camera, 960x540. Metres are 48 / disparity."""

    about = About(
        title="IRS",
        page="https://github.com/HKBU-HPML/IRS",
        licence="custom",
        kind="disparity",
        domain="indoor",
        layout="""
lists/irs_train.list, irs_test.list                          (from the page)
IRSDataset/Home/ArchVizInterior03Data/l_00001.png            (also Office, Restaurant, Store)
IRSDataset/Home/ArchVizInterior03Data/d_00001.exr
""",
        unit="float EXR of one channel, disparity in pixels, positive",
        splits={"train": None, "test": 14762},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        name = f"lists/irs_{self.split}.list"
        pairs = []
        for row in self.lines(name, origin="from github.com/HKBU-HPML/IRS", files=("left", "right", "disparity")):
            # In older lists the paths begin with the folder.
            left, disparity = (f"IRSDataset/{row[place].removeprefix('IRSDataset/')}" for place in (0, 2))
            pairs.append(PairFiles(self.inside(left), self.inside(disparity)))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        disparity = read_exr(pair.target)
        return disparity, np.isfinite(disparity) & (disparity > 0)

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The authors give the focal length; the principal point of a rendered picture is its middle.
        return Intrinsics(480, 480, (size[1] - 1) / 2, (size[0] - 1) / 2)
