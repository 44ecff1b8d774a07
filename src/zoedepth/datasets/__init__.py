"""The published data sets, one small class each. ``DATASETS`` is the only list of them."""

from zoedepth.datasets.apolloscape import ApolloScape
from zoedepth.datasets.blendedmvs import BlendedMVS
from zoedepth.datasets.ddad import DDAD
from zoedepth.datasets.diml import DIMLIndoor, DIMLOutdoor
from zoedepth.datasets.diode import DIODEIndoor, DIODEOutdoor
from zoedepth.datasets.hrwsi import HRWSI
from zoedepth.datasets.hypersim import Hypersim
from zoedepth.datasets.ibims import IBims
from zoedepth.datasets.irs import IRS
from zoedepth.datasets.kitti import KITTI
from zoedepth.datasets.megadepth import MegaDepth
from zoedepth.datasets.movies3d import Movies3D
from zoedepth.datasets.nyu import NYU
from zoedepth.datasets.published import PublishedDataset
from zoedepth.datasets.redweb import ReDWeb
from zoedepth.datasets.sunrgbd import SUNRGBD
from zoedepth.datasets.tartanair import TartanAir
from zoedepth.datasets.vkitti2 import VKITTI2
from zoedepth.datasets.wsvd import WSVD

DATASETS: dict[str, type[PublishedDataset]] = {
    "nyu": NYU,
    "sunrgbd": SUNRGBD,
    "ibims": IBims,
    "diode-indoor": DIODEIndoor,
    "hypersim": Hypersim,
    "kitti": KITTI,
    "vkitti2": VKITTI2,
    "ddad": DDAD,
    "diml-outdoor": DIMLOutdoor,
    "diode-outdoor": DIODEOutdoor,
    "hrwsi": HRWSI,
    "blendedmvs": BlendedMVS,
    "redweb": ReDWeb,
    "diml-indoor": DIMLIndoor,
    "movies3d": Movies3D,
    "megadepth": MegaDepth,
    "wsvd": WSVD,
    "tartanair": TartanAir,
    "apolloscape": ApolloScape,
    "irs": IRS,
}
"""Name → class, in the order of the documentation."""
