"""iBims-1, in the layout of its ibims1_core_raw.zip."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.images import read_image
from zoedepth.stored import read_numbers, read_png


class IBims(PublishedDataset):
    """100 photos of rooms with a laser scanner's depth, made for judging edges and planes."""

    about = About(
        title="iBims-1",
        page="https://www.asg.ed.tum.de/lmf/ibims1/",
        licence="custom, research",
        kind="depth",
        domain="indoor",
        layout="""
imagelist.txt                             (a download of its own; may lie in ibims1_core_raw/)
ibims1_core_raw/rgb/corridor_01.png
ibims1_core_raw/depth/corridor_01.png
ibims1_core_raw/mask_invalid/corridor_01.png, mask_transp/corridor_01.png
ibims1_core_raw/calib/corridor_01.txt
""",
        unit="16-bit PNG, metres = value * 50 / 65535, unknown where 0 or where a mask is 0 (invalid, transparent)",
        splits={"test": 100},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        # The folder may also be ibims1_core_raw itself.
        base = "ibims1_core_raw" if (self.root / "ibims1_core_raw").is_dir() else "."
        listed = "imagelist.txt" if (self.root / "imagelist.txt").is_file() else f"{base}/imagelist.txt"
        pairs = []
        for name, *_ in self.lines(listed, origin="from the same page"):
            pairs.append(
                PairFiles(
                    self.inside(f"{base}/rgb/{name}.png"),
                    self.inside(f"{base}/depth/{name}.png"),
                    masks=tuple(self.inside(f"{base}/{mask}/{name}.png") for mask in ("mask_invalid", "mask_transp")),
                    camera=self.inside(f"{base}/calib/{name}.txt"),
                )
            )
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_png(pair.target).astype(np.float32) * (50 / 65535)
        known = depth > 0
        for path in pair.masks:
            # A photo's reader takes 1 bit, which a reader of depth refuses.
            mask = read_image(path, photo=False)[..., 0] > 0
            if mask.shape != depth.shape:
                raise InputError(f"{path} is {mask.shape} and {pair.target} is {depth.shape}: sizes must agree")
            known &= mask
        return depth, known

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        assert pair.camera is not None
        numbers = read_numbers(pair.camera)
        if len(numbers) != 4:
            raise InputError(f"{pair.camera} must hold four numbers, fx, fy, cx, cy; it holds {len(numbers)}")
        return Intrinsics(*numbers)
