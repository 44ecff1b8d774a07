"""AdaBins (shariqfarooq123/AdaBins ``AdaBins_nyu.pt``, ``AdaBins_kitti.pt``)."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.config import AdaBinsNetworkConfig, BaselineConfig
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

_LAYER, _TOKENS = "adaptive_bins_layer", "adaptive_bins_layer.patch_transformer"


def unet_rows() -> list[Row]:
    """Return the rows of encoder and U-Net, which PixelBins shares. Encoders have timm's names."""
    return [
        Row("encoder.original_model.bn2.*", None),  # comes after the map that is used
        Row("encoder.original_model.*", "encoder.network.*"),
        Row("decoder.conv2.*", "decoder.bottleneck.*"),
        *(Row(f"decoder.up{i + 1}._net.*", f"decoder.levels.{i}.convs.*") for i in range(4)),
        Row("decoder.conv3.*", "decoder.last.*"),
    ]


TABLE = Table([
    *unet_rows(),
    Row(f"{_TOKENS}.embedding_convPxP.*", "bins.tokens.embed.*"),
    Row(f"{_TOKENS}.positional_encodings", "bins.tokens.positions"),
    Row(f"{_TOKENS}.transformer_encoder.*", "bins.tokens.transformer.*"),
    Row(f"{_LAYER}.conv3x3.*", "bins.features.*"),
    Row(f"{_LAYER}.regressor.*", "bins.widths.*"),
    Row("conv_out.0.*", "bins.probability.*"),
    # Two older names, see its ``model_io.py``.
    Row(f"{_TOKENS}.embedding_encoder.*", "bins.tokens.embed.*"),
    Row(f"{_LAYER}.embedding_conv.*", "bins.features.*"),
])  # fmt: skip


def is_adabins(weights: Mapping[str, Tensor]) -> bool:
    """Return True if these are the names of this layout."""
    return any(name.startswith(f"{_LAYER}.") for name in unwrapped(weights))


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of an AdaBins state dict.

    No file holds the depth range: NYU's is taken (10 m); KITTI's is 80 m.

    Raises:
        InputError: there are unknown weights, or one that tells the config is missing.
    """
    ours = TABLE.to_ours(unwrapped(weights))
    with shapes.errors_named(TABLE):
        n_bins = shapes.shape_of(ours, "bins.probability.weight", 4)[0]
    return BaselineConfig(network=AdaBinsNetworkConfig(n_bins=n_bins)), ours, TABLE
