"""LocalBins (shariqfarooq123/LocalBins, what its training writes)."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.config import BaselineConfig, LocalBinsNetworkConfig
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

TABLE = Table([
    Row("encoder.original_model.bn2.*", None),  # comes after the map that is used
    Row("encoder.original_model.*", "encoder.network.*"),
    Row("decoder.conv2.*", "decoder.bottleneck.*"),
    Row("decoder.up_blocks.{}._net.*", "decoder.levels.{}.convs.*"),
    Row("decoder.seed_projector._net.*", "projectors.seed.*"),
    Row("decoder.projectors.{}._net.*", "projectors.levels.{}.*"),
    Row("decoder.seed_bin_regressor._net.*", "bins.seed.*"),
    Row("decoder.splitters.{}._net.*", "bins.splitters.{}.*"),
    Row("decoder.conv_out.*", "probability.*"),
    Row("decoder.height_head.*", None),  # no loss used its output in the end
])  # fmt: skip


def is_localbins(weights: Mapping[str, Tensor]) -> bool:
    """Return True if these are the names of this layout."""
    return any(name.startswith("decoder.seed_bin_regressor.") for name in unwrapped(weights))


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a LocalBins state dict.

    No file holds the depth range: NYU's is taken (10 m); KITTI's is 80 m. The bins begin one width late, as in the code
    that trained it (``front_padding=False``).

    Raises:
        InputError: there are unknown weights, or one that tells the config is missing.
    """
    ours = TABLE.to_ours(unwrapped(weights))
    with shapes.errors_named(TABLE):
        n_seed_bins = shapes.shape_of(ours, "bins.seed.2.weight", 4)[0]
    return BaselineConfig(network=LocalBinsNetworkConfig(n_seed_bins=n_seed_bins, front_padding=False)), ours, TABLE
