"""PixelBins (khalilsarwari/depth ``epoch_*_model_weights.pth``, as its training writes them)."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.config import OUTDOOR, BaselineConfig, PixelBinsNetworkConfig
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.adabins import unet_rows
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

TABLE = Table([*unet_rows(), Row("bins_out.0.*", "bins.widths.*"), Row("conv_out.0.*", "bins.probability.*")])


def is_pixelbins(weights: Mapping[str, Tensor]) -> bool:
    """Return True if these are the names of this layout."""
    return any(name.startswith("bins_out.0.") for name in unwrapped(weights))


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a PixelBins state dict.

    No file holds the depth range; its code trains with 0.001 to 80 m everywhere, on NYU too.

    Raises:
        InputError: there are unknown weights, or one that tells the config is missing.
    """
    ours = TABLE.to_ours(unwrapped(weights))
    with shapes.errors_named(TABLE):
        n_bins = shapes.shape_of(ours, "bins.probability.weight", 4)[0]
    return BaselineConfig(network=PixelBinsNetworkConfig(n_bins=n_bins), domains=(OUTDOOR,)), ours, TABLE
