from dataclasses import replace

import pytest
import torch
from tests.models import random_model

from zoedepth.config import INDOOR, OUTDOOR, AttractorConfig, Domain, EncoderConfig, ModelConfig, RouterConfig
from zoedepth.errors import InputError
from zoedepth.losses import silog
from zoedepth.model.upsample import convex_upsample, upsample
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ENCODERS, PRESETS

MEAN = AttractorConfig(
    n_bins=8, n_attractors=(4, 3, 2, 1), reduce="mean", embedding_width=16, projector_width=16, seed_width=16
)


def photos(batch: int = 4, size: tuple[int, int] = (64, 64)) -> torch.Tensor:
    """Noise, each image brighter and of more contrast than the one before."""
    noise = torch.rand(batch, 3, *size, generator=torch.Generator().manual_seed(0))
    return noise * torch.linspace(0.05, 1, batch).view(-1, 1, 1, 1)


@torch.no_grad()
def split_routes(model: ZoeDepth, pixels: torch.Tensor) -> list[int]:
    """Shift the router's last bias so that images of a batch take different heads in turn; return the heads."""
    logits = model(pixels).domain_logits
    lead = logits[:, 1] - logits[:, 0]
    last = [module for module in model.router.modules() if isinstance(module, torch.nn.Linear)][-1]
    last.bias[1] -= lead.median() + (lead.max() - lead.median()) / 1e3
    return model(pixels).domain.tolist()


# --- one image --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(64, 64), (32, 32), (32, 96), (160, 64)])
def test_outputs_have_the_size_of_the_input(tiny_model: ZoeDepth, size: tuple[int, int]):
    output = tiny_model(photos(2, size), return_std=True, return_bins=True)
    assert output.depth.shape == output.relative.shape == output.std.shape == (2, 1, *size)
    assert output.bin_centers.shape == output.probability.shape == (2, 8, *size)
    assert output.domain.shape == (2,)
    assert output.domain_logits.shape == (2, 2)
    assert all(x.isfinite().all() for x in output if isinstance(x, torch.Tensor))
    assert (output.relative >= 0).all()


def test_bins_come_only_on_request(tiny_model: ZoeDepth):
    with_bins, without = tiny_model(photos(), return_bins=True), tiny_model(photos())
    assert without.bin_centers is None
    assert without.probability is None
    assert torch.equal(with_bins.depth, without.depth)
    assert with_bins.std is None
    expected = (with_bins.probability * with_bins.bin_centers).sum(dim=1, keepdim=True)
    assert torch.allclose(with_bins.depth, expected, atol=1e-5)


def test_std_is_that_of_the_bins_and_comes_only_on_request(tiny_model: ZoeDepth):
    output = tiny_model(photos(1, (32, 32)), return_std=True, return_bins=True)
    centers, probability = output.bin_centers[0, :, 9, 20].tolist(), output.probability[0, :, 9, 20].tolist()
    mean = sum(p * c for p, c in zip(probability, centers, strict=True))
    variance = sum(p * (c - mean) ** 2 for p, c in zip(probability, centers, strict=True))
    assert output.std[0, 0, 9, 20].item() == pytest.approx(variance**0.5, rel=1e-3)
    assert tiny_model(photos(1, (32, 32))).std is None


@pytest.mark.parametrize("upsampling", ["bilinear", "convex"])
def test_half_resolution_decoder_still_answers_at_the_size_of_the_input(tiny_config: ModelConfig, upsampling: str):
    decoder = replace(tiny_config.decoder, output_stride=2, upsampling=upsampling)
    output = random_model(replace(tiny_config, decoder=decoder))(photos(), return_bins=True)
    assert output.depth.shape == output.relative.shape == (4, 1, 64, 64)
    assert output.probability.shape == (4, 8, 64, 64)
    assert torch.allclose(output.probability.sum(dim=1), torch.ones(4, 64, 64), atol=1e-5)


def test_convex_upsampling_gives_depth_and_deviation_the_same_weights_from_the_normalised_photo(
    tiny_config: ModelConfig,
):
    decoder = replace(tiny_config.decoder, output_stride=2, upsampling="convex")
    model, seen = random_model(replace(tiny_config, decoder=decoder)), []
    torch.nn.init.normal_(model.convex.conv2.weight)
    model.convex.register_forward_hook(lambda module, inputs, weights: seen.append((inputs, weights)))
    output = model(photos(), domain=torch.ones(4, dtype=torch.long), return_std=True)
    [((last, pixels), weights)] = seen
    decoded = model.relative_features(photos())
    # Values, not bits: sums may be taken in another order the second time.
    torch.testing.assert_close(last, decoded.last)
    torch.testing.assert_close(pixels, 2 * photos() - 1)
    depth, std = model.heads[1](model.shared(decoded)).depth_and_std()
    torch.testing.assert_close(output.depth, convex_upsample(depth, weights))
    torch.testing.assert_close(output.std, convex_upsample(std, weights))
    assert not torch.allclose(output.depth, upsample(depth, output.depth.shape[-2:]), rtol=1e-5)


def test_pixels_are_normalised_by_the_model(tiny_model: ZoeDepth):
    """[0, 1] becomes [-1, 1]: mean 0.5 and standard deviation 0.5, for every channel."""
    pixels = photos()
    seen = []
    tiny_model.encoder.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    tiny_model(pixels)
    assert torch.allclose(seen[0], (pixels - 0.5) / 0.5, atol=1e-6)


def test_input_is_left_alone(tiny_model: ZoeDepth):
    pixels = photos()
    before = pixels.clone()
    tiny_model(pixels)
    assert torch.equal(pixels, before)


def test_bfloat16_autocast_is_finite_and_close(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, head=MEAN))
    given = torch.tensor([0, 1, 0, 1])
    exact = model(photos(), domain=given).depth
    with torch.autocast("cpu", dtype=torch.bfloat16):
        half = model(photos(), domain=given).depth
    assert half.dtype == torch.float32
    assert half.isfinite().all()
    assert ((half - exact).abs() / exact).mean() < 0.02


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (torch.zeros(3, 64, 64), r"\(3, 64, 64\)"),
        (torch.zeros(1, 1, 64, 64), r"\(1, 1, 64, 64\)"),
        (torch.zeros(1, 64, 64, 3), r"\(1, 64, 64, 3\)"),
        (torch.zeros(1, 3, 64, 64, dtype=torch.uint8), "uint8"),
        (torch.zeros(1, 3, 64, 65), r"\(64, 65\).*Predictor"),
        (torch.zeros(1, 3, 48, 64), "multiples of 32"),
        (torch.zeros(1, 3, 0, 64), r"\(0, 64\)"),
    ],
    ids=["no-batch", "grey", "channels-last", "uint8", "odd", "sixteen", "empty"],
)
def test_pixels_that_cannot_be_used_are_an_error_that_says_why(
    tiny_model: ZoeDepth, pixels: torch.Tensor, message: str
):
    with pytest.raises(InputError, match=message):
        tiny_model(pixels)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    "domain",
    [
        torch.tensor([0, 2]),
        torch.tensor([0, -1]),
        torch.tensor([0]),
        torch.tensor([0, 1, 0]),
        torch.tensor([[0], [1]]),
        torch.tensor([0.0, 1.0]),
    ],
    ids=["too-large", "negative", "too-few", "too-many", "matrix", "float"],
)
def test_domains_that_cannot_be_used_are_an_error(tiny_model: ZoeDepth, domain: torch.Tensor):
    with pytest.raises(InputError, match="domain"):
        tiny_model(photos(2), domain=domain)


# --- encoders ---------------------------------------------------------------------------------------------------------

SWIN = EncoderConfig(
    "swinv2_tiny_window16_256", "swin", size=(64, 64), width=24, depth=(1, 1, 2, 1), heads=(1, 2, 4, 8)
)


def test_swin_takes_one_size_only(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, encoder=SWIN))
    assert model(photos()).depth.shape == (4, 1, 64, 64)
    with pytest.raises(InputError, match=r"\(64, 64\) only; got \(64, 96\)"):
        model(photos(1, (64, 96)))


@pytest.mark.parametrize(
    "encoder", [SWIN, ENCODERS["tf_efficientnet_lite0"], None], ids=["swin", "efficientnet", "beit"]
)
def test_gradients_reach_every_part(tiny_config: ModelConfig, encoder: EncoderConfig | None):
    model = random_model(replace(tiny_config, head=MEAN, encoder=encoder or tiny_config.encoder))
    output = model(photos(), domain=torch.tensor([0, 1, 0, 1]))
    (output.depth.square().mean() + output.domain_logits.square().mean()).backward()
    assert [name for name, p in model.named_parameters() if p.grad is None] == []
    for part in (model.encoder, model.decoder, model.shared, model.router, *model.heads):
        assert sum(p.grad.abs().sum() for p in part.parameters()) > 0


def test_shipped_architecture_runs():
    torch.manual_seed(0)
    model = ZoeDepth(PRESETS["zoed-lite"]).eval()
    output = model(photos(2, (64, 96)), domain=torch.tensor([0, 1]))
    assert output.depth.shape == (2, 1, 64, 96)
    assert 0.5 < output.depth[0].mean() < 10
    assert 4 < output.depth[1].mean() < 80


# --- routing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("classifier", ["mlp", "transformer"])
def test_batch_that_routes_differently_equals_its_images_alone(tiny_config: ModelConfig, classifier: str):
    model = random_model(replace(tiny_config, router=replace(tiny_config.router, classifier=classifier)))
    pixels = photos(5)[[3, 0, 4, 1, 2]]
    heads = split_routes(model, pixels)
    assert set(heads) == {0, 1}
    assert heads not in (sorted(heads), sorted(heads, reverse=True)), "the order of the batch is not that of the heads"
    with torch.no_grad():
        together = model(pixels, return_std=True, return_bins=True)
        for i in range(5):
            alone = model(pixels[i : i + 1], return_std=True, return_bins=True)
            assert alone.domain.item() == together.domain[i].item()
            for one, all_of_them in zip(alone[:-1], together[:-1], strict=True):  # maps and numbers
                assert torch.allclose(one[0], all_of_them[i], atol=1e-5)


def test_each_image_takes_the_head_of_its_domain(tiny_config: ModelConfig):
    """Heads of normed centers cannot leave their range, so the ranges of the depth show which head an image took."""
    domains = (Domain("near", 1.0, 2.0), Domain("middle", 10.0, 20.0), Domain("far", 50.0, 100.0))
    model = random_model(replace(tiny_config, head=replace(MEAN, centers="normed"), domains=domains))
    given = torch.tensor([2, 0, 1, 0, 2])
    output = model(photos(5), domain=given)
    assert torch.equal(output.domain, given)
    for depth, index in zip(output.depth, given.tolist(), strict=True):
        assert domains[index].min_depth <= depth.min()
        assert depth.max() <= domains[index].max_depth


def test_given_domain_overrides_the_router(tiny_model: ZoeDepth):
    pixels = photos(2)
    routed = tiny_model(pixels)
    other = 1 - routed.domain
    forced = tiny_model(pixels, domain=other)
    assert torch.equal(forced.domain, other)
    assert torch.allclose(forced.domain_logits, routed.domain_logits, atol=1e-6)
    assert not torch.allclose(forced.depth, routed.depth, atol=1e-4)
    assert torch.allclose(tiny_model(pixels, domain=routed.domain).depth, routed.depth, atol=1e-6)


def test_labeled_router_needs_labels(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, router=RouterConfig("labeled")))
    with pytest.raises(InputError, match="domain"):
        model(photos(2))
    output = model(photos(2), domain=torch.tensor([1, 0]))
    assert output.domain.tolist() == [1, 0]
    assert output.domain_logits is None


def test_one_domain_has_no_router(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, domains=(OUTDOOR,)))
    output = model(photos(2))
    assert output.domain.tolist() == [0, 0]
    assert output.domain_logits is None
    assert list(model.router.parameters()) == []


def test_auto_router_mixes_the_depths_of_all_heads_while_training(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, router=RouterConfig("auto", width=16))).train()
    pixels = photos(2)
    mixed = model(pixels, return_bins=True)
    weights = mixed.domain_logits.softmax(dim=1)
    by_head = [model(pixels, domain=torch.full((2,), index)).depth for index in range(2)]
    for i in range(2):
        expected = weights[i, 0] * by_head[0][i] + weights[i, 1] * by_head[1][i]
        assert torch.allclose(mixed.depth[i], expected, atol=1e-5)
    assert mixed.probability.shape == (2, 16, 64, 64)
    assert torch.allclose(mixed.probability.sum(dim=1), torch.ones(2, 64, 64), atol=1e-5)


def test_auto_router_takes_its_best_head_in_evaluation(tiny_config: ModelConfig):
    model = random_model(replace(tiny_config, router=RouterConfig("auto", width=16)))
    pixels = photos(5)
    assert set(split_routes(model, pixels)) == {0, 1}
    output = model(pixels)
    assert torch.equal(output.domain, output.domain_logits.argmax(dim=1))
    assert torch.allclose(output.depth, model(pixels, domain=output.domain).depth, atol=1e-6)


@pytest.mark.parametrize(("kind", "learns"), [("auto", True), ("trained", False)])
def test_only_the_auto_router_learns_from_the_depth(tiny_config: ModelConfig, kind: str, learns: bool):
    model = random_model(replace(tiny_config, head=MEAN, router=RouterConfig(kind, width=16))).train()
    depth = model(photos()).depth
    silog(depth, torch.full_like(depth, 3.0), torch.ones_like(depth, dtype=torch.bool)).backward()
    gradients = [p.grad for p in model.router.parameters()]
    assert all(g is not None and g.abs().sum() > 0 for g in gradients) == learns
    assert all(g is None for g in gradients) != learns


def test_shared_part_is_shared_and_heads_are_their_own(tiny_config: ModelConfig):
    model = random_model(tiny_config)
    assert len(model.heads) == 2
    before = model(photos(2), domain=torch.tensor([0, 1])).depth
    with torch.no_grad():
        for p in model.heads[1].parameters():
            p.add_(0.1)
    after = model(photos(2), domain=torch.tensor([0, 1])).depth
    assert torch.allclose(after[0], before[0], atol=1e-6)
    assert not torch.allclose(after[1], before[1], atol=1e-3)


def test_relative_depth_does_not_depend_on_the_domain(tiny_model: ZoeDepth):
    one, other = (tiny_model(photos(2), domain=torch.full((2,), index)).relative for index in (0, 1))
    assert torch.equal(one, other)


def test_relative_features_are_those_of_the_whole_model(tiny_model: ZoeDepth):
    assert torch.equal(tiny_model.relative_features(photos()).relative, tiny_model(photos()).relative)


def test_any_number_of_domains(tiny_config: ModelConfig):
    domains = (INDOOR, OUTDOOR, Domain("underwater", 0.1, 20.0), Domain("aerial", 10.0, 500.0))
    output = random_model(replace(tiny_config, domains=domains))(photos(4), domain=torch.tensor([3, 2, 1, 0]))
    assert output.domain_logits.shape == (4, 4)
    assert output.depth.isfinite().all()


# --- without metric heads ---------------------------------------------------------------------------------------------


def test_model_without_domains_is_encoder_and_decoder(tiny_model: ZoeDepth, tiny_config: ModelConfig):
    model = ZoeDepth(replace(tiny_config, domains=())).eval()
    kept = {name: value for name, value in tiny_model.state_dict().items() if name.startswith(("encoder", "decoder"))}
    model.load_state_dict(kept)
    relative = model.relative(photos())
    assert relative.shape == (4, 1, 64, 64)
    assert torch.equal(relative, tiny_model(photos()).relative)
    assert torch.equal(relative, tiny_model.relative(photos()))


def test_model_without_domains_has_no_metres(tiny_config: ModelConfig):
    model = ZoeDepth(replace(tiny_config, domains=())).eval()
    with pytest.raises(InputError, match="relative depth only"):
        model(photos())
    with pytest.raises(InputError, match="multiples of 32"):
        model.relative(photos(size=(60, 64)))
