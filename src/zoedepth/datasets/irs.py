"""IRS: rendered rooms for indoor robots, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.errors import InputError
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

    def list_frames(self) -> Sequence[Frame]:
        name = f"lists/irs_{self.split}.list"
        frames = []
        for number, row in enumerate(self.lines(name, origin="from github.com/HKBU-HPML/IRS"), start=1):
            if len(row) < 3:
                raise InputError(self.explain(f"line {number} of {name} must name left, right and disparity"))
            # The older lists begin with the folder.
            left, disparity = (f"IRSDataset/{row[place].removeprefix('IRSDataset/')}" for place in (0, 2))
            frames.append(Frame(self.inside(left), self.inside(disparity)))
        return frames

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        disparity = read_exr(frame.target)
        return disparity, np.isfinite(disparity) & (disparity > 0)

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        # The focal length is the authors'; a rendered picture's principal point is its middle.
        return Intrinsics(480, 480, (size[1] - 1) / 2, (size[0] - 1) / 2)
