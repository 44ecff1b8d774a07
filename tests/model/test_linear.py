"""Linear layers as convolutions: the same numbers, and nothing else about a model changes."""

import copy
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import nn

import zoedepth.model.linear
from zoedepth import load_model, save_model
from zoedepth.build import build_model
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.linear import SWITCH, ConvolvedLinear, products_are_slow, replace_linear
from zoedepth.model.zoedepth import ZoeDepth


@pytest.fixture
def slow_products(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(SWITCH, "1")


def n_convolved(model: nn.Module) -> int:
    return sum(isinstance(module, ConvolvedLinear) for module in model.modules())


@pytest.mark.parametrize("shape", [(2, 7, 8), (5, 8), (2, 3, 4, 8), (8,)])
@pytest.mark.parametrize("bias", [True, False])
def test_rows_of_any_shape_are_multiplied(slow_products: None, shape: tuple[int, ...], bias: bool):
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(8, 12, bias=bias))
    x = torch.randn(shape)
    expected = network(x)
    replace_linear(network)
    assert isinstance(network[0], ConvolvedLinear)
    with torch.no_grad():
        found = network(x)
    assert found.shape == expected.shape
    assert torch.allclose(found, expected, atol=1e-6)


def test_gradients_and_other_precisions_use_torchs_own_products(slow_products: None, monkeypatch: pytest.MonkeyPatch):
    network = nn.Sequential(nn.Linear(8, 12))
    replace_linear(network)
    monkeypatch.setattr(zoedepth.model.linear.F, "conv2d", None)
    x = torch.randn(3, 8)
    network(x).sum().backward()
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        assert network(x).dtype == torch.bfloat16
    with torch.no_grad():
        assert network.double()(x.double()).dtype == torch.float64
        with pytest.raises(TypeError):  # a convolution, which is missing here
            network.float()(x)


@torch.no_grad()
def test_a_model_keeps_its_depth_its_keys_and_its_file(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    torch.manual_seed(0)
    monkeypatch.setenv(SWITCH, "0")
    model = build_model(tiny_config).eval()
    save_model(model, tmp_path / "model.safetensors")
    monkeypatch.setenv(SWITCH, "1")
    other = load_model(tmp_path / "model.safetensors")
    assert n_convolved(other) > 0
    assert n_convolved(model) == 0
    assert list(other.state_dict()) == list(model.state_dict())
    pixels, called = torch.rand(2, 3, 64, 96), set()
    for module in other.modules():
        if isinstance(module, ConvolvedLinear):
            module.register_forward_hook(lambda module, *_: called.add(module))
    # Sums in another order: a few units in the last place of float32 (1.2e-7), through four blocks.
    assert torch.allclose(other(pixels).depth, model(pixels).depth, rtol=1e-5)
    assert len(called) == n_convolved(other), "timm calls the layers, and does not take their weights only"
    save_model(other, tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == (tmp_path / "model.safetensors").read_bytes()


def test_a_seed_gives_the_same_weights_on_any_processor(tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch):
    weights = []
    for slow in ("0", "1"):
        monkeypatch.setenv(SWITCH, slow)
        torch.manual_seed(0)
        weights.append(ZoeDepth(tiny_config).state_dict())
    assert all(torch.equal(value, weights[1][name]) for name, value in weights[0].items())


@pytest.mark.parametrize("slow", [True, False])
def test_every_way_to_a_model_gives_the_same_layers(
    slow: bool, tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def ways() -> Iterator[nn.Module]:
        built = build_model(tiny_config).eval()
        yield built
        yield ZoeDepth(tiny_config)
        yield copy.deepcopy(built)
        save_model(built, tmp_path / "model.safetensors")
        yield load_model(tmp_path / "model.safetensors")
        with torch.device("meta"):
            yield build_model(tiny_config)

    monkeypatch.setenv(SWITCH, "1" if slow else "0")
    counts = [n_convolved(model) for model in ways()]
    assert counts == [4 * 4 if slow else 0] * 5, "four layers in each of four blocks"


@pytest.mark.parametrize(
    ("about", "capability", "instructions", "slow"),
    [
        ("vendor_id\t: AuthenticAMD\n", "AVX512", None, True),
        ("vendor_id\t: AuthenticAMD\n", "AVX2", None, False),
        ("vendor_id\t: GenuineIntel\n", "AVX512", None, False),
        ("vendor_id\t: GenuineIntel\n", "AVX512", "AVX2", True),
        ("vendor_id\t: GenuineIntel\n", "AVX2", "AVX2", False),
        ("vendor_id\t: GenuineIntel\n", "AVX512", "AVX512_E1", False),
    ],
)
def test_without_the_switch_the_processor_decides(
    about: str, capability: str, instructions: str | None, slow: bool, monkeypatch: pytest.MonkeyPatch
):
    decide = zoedepth.model.linear._processor_is_slow
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setattr(Path, "read_text", lambda path, encoding: about)
    monkeypatch.setattr(torch.backends.mkl, "is_available", lambda: True)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    if instructions is None:
        monkeypatch.delenv("MKL_ENABLE_INSTRUCTIONS", raising=False)
    else:
        monkeypatch.setenv("MKL_ENABLE_INSTRUCTIONS", instructions)
    try:
        decide.cache_clear()
        assert products_are_slow() is slow
        monkeypatch.setattr(torch.backends.mkl, "is_available", lambda: False)
        decide.cache_clear()
        assert products_are_slow() is False
    finally:
        decide.cache_clear()


@pytest.mark.parametrize(("value", "slow"), [("0", False), ("1", True)])
@pytest.mark.parametrize("maker", [True, False])
def test_the_switch_decides_on_any_processor(value: str, slow: bool, maker: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(zoedepth.model.linear, "_processor_is_slow", lambda: maker)
    monkeypatch.setenv(SWITCH, value)
    assert products_are_slow() is slow


@pytest.mark.parametrize("value", ["", "yes", "2"])
def test_another_value_of_the_switch_is_an_error(value: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(SWITCH, value)
    with pytest.raises(InputError, match=f"{SWITCH} is '{value}'. Set it to 1"):
        products_are_slow()
