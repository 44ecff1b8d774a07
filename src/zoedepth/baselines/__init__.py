"""The systems the paper compares with, each as its authors built it, a file each; ``BASELINES`` lists them."""

from zoedepth.baselines.adabins import AdaBins
from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.bts import Bts
from zoedepth.baselines.dorn import Dorn
from zoedepth.baselines.localbins import LocalBins
from zoedepth.baselines.newcrfs import NewCrfs
from zoedepth.baselines.pixelbins import PixelBins
from zoedepth.config import (
    AdaBinsNetwork,
    BaselineConfig,
    BtsNetwork,
    DornNetwork,
    LocalBinsNetwork,
    NetworkConfig,
    NewCrfsNetwork,
    PixelBinsNetwork,
)

__all__ = ["BASELINES", "Baseline", "build_baseline"]

BASELINES: dict[type[NetworkConfig], type[Baseline]] = {
    AdaBinsNetwork: AdaBins,
    LocalBinsNetwork: LocalBins,
    PixelBinsNetwork: PixelBins,
    NewCrfsNetwork: NewCrfs,
    BtsNetwork: Bts,
    DornNetwork: Dorn,
}
"""The config class of a network → the model."""


def build_baseline(config: BaselineConfig) -> Baseline:
    """The baseline of a config, with random weights, in training mode."""
    return BASELINES[type(config.network)](config)
