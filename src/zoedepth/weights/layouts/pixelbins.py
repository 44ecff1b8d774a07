"""PixelBins (khalilsarwari/depth ``epoch_*_model_weights.pth``, as its training writes them)."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.config import OUTDOOR, BaselineConfig, PixelBinsNetworkConfig
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.adabins import unet_rows
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

TABLE = Table([*unet_rows(), Row("bins_out.0.*", "bins.widths.*"), Row("conv_out.0.*", "bins.probability.*")])


def is_pixelbins(weights: Mapping[str, Tensor]) -> bool:
    """Whether these are the names of this layout."""
    return any(name.startswith("bins_out.0.") for name in unwrapped(weights))


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Config, weights under our names, and the table, of a PixelBins state dict.

    Its depth range is in no file; its code trains with 0.001 to 80 m everywhere, on NYU too.

    Raises:
        InputError: unknown weights, or a missing one that the config is told by.
    """
    ours = TABLE.to_ours(unwrapped(weights))
    with shapes.errors_named(TABLE):
        n_bins = shapes.shape_of(ours, "bins.probability.weight", 4)[0]
    return BaselineConfig(network=PixelBinsNetworkConfig(n_bins=n_bins), domains=(OUTDOOR,)), ours, TABLE
