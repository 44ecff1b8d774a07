"""The published data sets, one small class each. :data:`DATASETS` is the only list of them."""

from zoedepth.datasets.kitti import KITTI
from zoedepth.datasets.nyu import NYU
from zoedepth.datasets.published import PublishedDataset

DATASETS: dict[str, type[PublishedDataset]] = {
    "nyu": NYU,
    "kitti": KITTI,
}
"""Name → class."""
