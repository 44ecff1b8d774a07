"""The systems the paper compares with, each as its authors built it, in a file of its own. ``BASELINES`` lists them."""

from zoedepth.baselines.adabins import AdaBins
from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.bts import Bts
from zoedepth.baselines.dorn import Dorn
from zoedepth.baselines.localbins import LocalBins
from zoedepth.baselines.newcrfs import NewCrfs
from zoedepth.baselines.pixelbins import PixelBins
from zoedepth.config import (
    AdaBinsNetworkConfig,
    BtsNetworkConfig,
    DornNetworkConfig,
    LocalBinsNetworkConfig,
    NetworkConfig,
    NewCrfsNetworkConfig,
    PixelBinsNetworkConfig,
)

__all__ = ["BASELINES", "Baseline"]

BASELINES: dict[type[NetworkConfig], type[Baseline]] = {
    AdaBinsNetworkConfig: AdaBins,
    LocalBinsNetworkConfig: LocalBins,
    PixelBinsNetworkConfig: PixelBins,
    NewCrfsNetworkConfig: NewCrfs,
    BtsNetworkConfig: Bts,
    DornNetworkConfig: Dorn,
}
"""Config class of a network → the class of the model."""
