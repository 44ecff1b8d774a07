"""iBims-1, in the layout of its ibims1_core_raw.zip."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
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

    def list_frames(self) -> Sequence[Frame]:
        # The folder ibims1_core_raw itself will do, too.
        base = "ibims1_core_raw" if (self.root / "ibims1_core_raw").is_dir() else "."
        listed = "imagelist.txt" if (self.root / "imagelist.txt").is_file() else f"{base}/imagelist.txt"
        frames = []
        for name, *_ in self.lines(listed, origin="from the same page"):
            frames.append(
                Frame(
                    self.inside(f"{base}/rgb/{name}.png"),
                    self.inside(f"{base}/depth/{name}.png"),
                    masks=tuple(self.inside(f"{base}/{mask}/{name}.png") for mask in ("mask_invalid", "mask_transp")),
                    camera=self.inside(f"{base}/calib/{name}.txt"),
                )
            )
        return frames

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        depth = read_png(frame.target).astype(np.float32) * (50 / 65535)
        known = depth > 0
        for path in frame.masks:
            mask = read_image(path)[..., 0]  # a photo's reader: they have 1 bit, which those of depth refuse
            if mask.shape != depth.shape:
                raise InputError(f"{path} is {mask.shape} and {frame.target} is {depth.shape}: sizes must agree")
            known &= mask > 0
        return depth, known

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        assert frame.camera is not None
        numbers = read_numbers(frame.camera)
        if len(numbers) != 4:
            raise InputError(f"{frame.camera} must hold fx, fy, cx, cy; it holds {len(numbers)} numbers")
        return Intrinsics(*numbers)
