from pathlib import Path

import numpy as np
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample

SIZE = (6, 8)


class TestDDAD(DatasetTester):
    name = "ddad"
    split = "test"

    def write(self, root: Path) -> None:
        for number in range(2):
            write_photo(root / f"ddad_val/{number:06d}_rgb.png", SIZE)
            depth = np.zeros(SIZE)
            depth[1, ::4] = 120.5
            depth[2, 0] = np.inf
            np.save(root / f"ddad_val/{number:06d}_depth.npy", depth)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "ddad_val/000000_rgb.png"
        assert sample.mask[0].nonzero().tolist() == [[1, 0], [1, 4]]
        assert (sample.target[sample.mask] == 120.5).all()
        assert sample.domain == "outdoor"
        assert sample.camera is None
