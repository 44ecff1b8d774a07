"""PixelBins: its range. (``test_adabins.py`` compares its names, which are AdaBins' but for the bins.)"""

from tests.weights.layouts.layouts import released

from zoedepth.config import OUTDOOR, BaselineConfig, PixelBinsNetworkConfig
from zoedepth.weights.layouts import pixelbins


def test_config_has_the_bins_of_the_file_and_the_range_of_its_code():
    theirs = released("pixelbins")
    theirs |= {"conv_out.0.weight": theirs["conv_out.0.weight"][:32], "conv_out.0.bias": theirs["conv_out.0.bias"][:32]}
    config, _, _ = pixelbins.read(theirs)
    assert config == BaselineConfig(PixelBinsNetworkConfig(n_bins=32), domains=(OUTDOOR,))
