"""BTS (cleinc/bts ``pytorch/``), as ``bts_main.py`` saves it."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.baselines.bts import RATES
from zoedepth.config import BaselineConfig, BtsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

_WIDTH = "decoder.bn5.weight"
"""Weight whose length is the width of the decoder."""


def is_bts(weights: Mapping[str, Tensor]) -> bool:
    """Return True if these are the names of this layout."""
    return any(name.startswith("decoder.daspp_") for name in unwrapped(weights))


def table(width: int) -> Table:
    """Return the names of encoder and decoder. The width tells how many layers lead to the planes."""
    rows = [
        Row("encoder.base_model.fc.*", None),  # a ResNet's ImageNet classifier
        Row("encoder.base_model.*", "encoder.stages.*"),
    ]
    for number, stride in ((5, 16), (4, 8), (3, 4), (2, 2), (1, 1)):
        rows += [
            Row(f"decoder.upconv{number}.conv.*", f"decoder.up{stride}.conv.0.*"),
            Row(f"decoder.conv{number}.0.*", f"decoder.fuse{stride}.0.*"),
        ]
        if number > 1:
            rows.append(Row(f"decoder.bn{number}.*", f"decoder.up{stride}.norm.*"))
    rows.append(Row("decoder.bn4_2.*", "decoder.fuse8.2.*"))
    for i, rate in enumerate(RATES):
        theirs, ours = f"decoder.daspp_{rate}.atrous_conv", f"decoder.context.branches.{i}"
        rows.append(Row(f"{theirs}.first_bn.*", f"{ours}.0.*"))
        rows += [Row(f"{theirs}.aconv_sequence.{layer}.*", f"{ours}.{layer + 1}.*") for layer in (1, 2, 4)]
    rows.append(Row("decoder.daspp_conv.0.*", "decoder.context.mix.0.*"))
    for stride, channels, hidden in (
        (8, width // 4, width // 4),
        (4, width // 4, width // 8),
        (2, width // 8, width // 16),
    ):
        rows += _narrowing(f"decoder.reduc{stride}x{stride}.reduc", f"decoder.guide{stride}.planes", channels, hidden)
    rows += _narrowing("decoder.reduc1x1.reduc", "decoder.guess", width // 16, width // 32)
    return Table([*rows, Row("decoder.get_depth.0.*", "decoder.depth.*")])


def _narrowing(theirs: str, ours: str, channels: int, hidden: int) -> list[Row]:
    """Return the rows of the layers that halve their channels (``heads.bts.narrowing``)."""
    rows = []
    while hidden >= 8:
        rows.append(Row(f"{theirs}.inter_{channels}_{hidden}.0.*", f"{ours}.{2 * len(rows)}.*"))
        channels, hidden = hidden, hidden // 2
    last = "final.0" if ours == "decoder.guess" else "plane_params"
    return [*rows, Row(f"{theirs}.{last}.*", f"{ours}.{2 * len(rows)}.*")]


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table. No weight tells range and focal length: NYU's are taken.

    Raises:
        InputError: there are unknown weights, or the encoder is unknown (BTS's MobileNet, which timm does not have).
    """
    given = unwrapped(weights)
    if _WIDTH not in given or given[_WIDTH].ndim != 1:
        raise InputError(f"{_WIDTH} is missing, or does not have one axis: this is no whole checkpoint of BTS")
    network = BtsNetworkConfig(_encoder(given), width=len(given[_WIDTH]))
    names = table(network.width)
    return BaselineConfig(network), names.to_ours(given), names


def _encoder(weights: Mapping[str, Tensor]) -> str:
    """Return timm's name of the encoder, told by its first layer, the length of its third stage, and its groups."""
    for channels, name in ((96, "densenet161"), (64, "densenet121")):
        first = weights.get("encoder.base_model.conv0.weight")
        if first is not None and first.shape[:1] == (channels,):
            return name
    grouped = weights.get("encoder.base_model.layer1.0.conv2.weight")
    if grouped is not None:
        deep = "encoder.base_model.layer3.22.conv1.weight" in weights
        for shape, name in (
            ((64, 64), "resnet101" if deep else "resnet50"),
            ((128, 4), "resnext50_32x4d"),
            ((256, 8), "resnext101_32x8d"),
        ):
            if tuple(grouped.shape[:2]) == shape and deep == ("101" in name):
                return name
    raise InputError(
        "this BTS has another encoder than the known ones: DenseNet-121 and -161, ResNet-50 and -101, ResNeXt-50 "
        "and -101"
    )
