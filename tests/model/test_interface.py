import pytest
import torch

from zoedepth.build import build_model
from zoedepth.config import BaselineConfig, BtsNetworkConfig, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.heads.output import HeadOutput, Ordinal, Supervision, WindowBins
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.interface import DepthOutput, at_pixels, depth_output, in_batch_order
from zoedepth.model.router import Routing
from zoedepth.model.upsample import upsample
from zoedepth.model.zoedepth import ZoeDepth

SIZE = torch.Size((8, 12))


def distribution(batch: int = 2) -> BinDistribution:
    """Five bins at a quarter of ``SIZE``."""
    generator = torch.Generator().manual_seed(0)
    logits, centers = (torch.randn(batch, 5, 4, 6, generator=generator) for _ in range(2))
    return BinDistribution(logits, None, None, 5 + centers)


@pytest.mark.parametrize("std", [True, False])
@pytest.mark.parametrize("bins", [True, False])
def test_maps_have_the_size_of_the_pixels_and_come_on_request(std: bool, bins: bool):
    found, relative = distribution(), torch.rand(2, 1, 4, 6)
    routing = Routing(torch.tensor([1, 0]), torch.rand(2, 2))
    supervision = Supervision(image_bins=torch.rand(2, 5))
    output = depth_output(HeadOutput(found, supervision), relative, routing, std=std, bins=bins)
    output = at_pixels(output, SIZE)
    mean, spread = found.mean_and_std()
    assert torch.allclose(output.depth, upsample(mean, SIZE))
    assert torch.equal(output.relative, upsample(relative, SIZE))
    assert output.domain is routing.domain
    assert output.domain_logits is routing.logits
    assert output.supervision is supervision
    assert (output.std is not None) == std
    assert output.std is None or torch.allclose(output.std, upsample(spread, SIZE))
    assert (output.bin_centers is not None) == (output.probability is not None) == bins
    if output.bin_centers is not None:
        assert torch.allclose(output.bin_centers, upsample(found.bin_centers, SIZE))
        assert torch.allclose(output.probability, upsample(found.probability, SIZE))


def test_a_head_without_distribution_has_depth_only():
    head = HeadOutput(torch.rand(2, 1, 8, 12))
    routing = Routing(torch.zeros(2, dtype=torch.long), None)
    output = at_pixels(depth_output(head, None, routing, std=True, bins=True), SIZE)
    assert output.depth is head.prediction
    assert output[1] is output.domain_logits is output.std is output.bin_centers is output.probability is None


def of_images(images: list[int], domain: list[int]) -> DepthOutput:
    """An output every number of which is that of the image."""
    number = torch.tensor(images, dtype=torch.float32)
    maps = number[:, None, None, None].expand(-1, 1, 4, 6)
    rows = number[:, None].expand(-1, 3)
    windows = WindowBins(number[:, None, None].expand(-1, 2, 4), (maps[:, 0, :2, :2], maps[:, 0, :2, :4]))
    return DepthOutput(
        maps, maps, torch.tensor(domain), rows, maps, maps, maps, Supervision(Ordinal(maps, rows), rows, windows)
    )


def leaves(output: object) -> list[torch.Tensor]:
    return [output] if isinstance(output, torch.Tensor) else [leaf for part in output for leaf in leaves(part)]


def test_groups_are_joined_in_the_order_of_the_batch():
    """Images 0 to 4 took domains 2, 0, 1, 0, 2."""
    domain = torch.tensor([2, 0, 1, 0, 2])
    joined = in_batch_order([of_images([1, 3], [0, 0]), of_images([2], [1]), of_images([0, 4], [2, 2])], domain)
    expected = of_images([0, 1, 2, 3, 4], [2, 0, 1, 0, 2])
    assert len(leaves(joined)) == len(leaves(expected)) == 13
    for found, wanted in zip(leaves(joined), leaves(expected), strict=True):
        assert torch.equal(found, wanted)


def test_what_the_groups_do_not_have_stays_away():
    none = (None, None, None, None)
    groups = [DepthOutput(torch.rand(1, 1, 4, 6), None, torch.tensor([i]), *none) for i in range(2)]
    joined = in_batch_order(groups, torch.tensor([1, 0]))
    assert torch.equal(joined.depth, torch.cat([groups[1].depth, groups[0].depth]))
    assert joined.relative is joined.domain_logits is joined.std is joined.bin_centers is joined.probability is None
    assert joined.supervision == Supervision()


def test_model_knows_the_device_of_its_weights(tiny_config: ModelConfig):
    with torch.device("meta"):
        assert ZoeDepth(tiny_config).device == torch.device("meta")


@pytest.mark.usefixtures("unchecked_types")
def test_baseline_checks_its_domain():
    with torch.device("meta"):
        model = build_model(BaselineConfig(BtsNetworkConfig("tf_efficientnet_lite0", width=128), size=(64, 96)))
        pixels = torch.zeros(1, 3, 64, 96)
    with pytest.raises(InputError, match="domain must hold 1 integers, one an image, from 0 to 0"):
        model.check(pixels, torch.tensor([1]))
    model.check(pixels, torch.tensor([0]))
