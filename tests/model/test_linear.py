"""Linear layers as convolutions: the same numbers, and nothing else about the model changes."""

from pathlib import Path

import pytest
import torch
from torch import nn

import zoedepth.model.linear
from zoedepth import load_model, save_model
from zoedepth.build import build_model
from zoedepth.config import ModelConfig
from zoedepth.model.linear import ConvolvedLinear, products_are_slow, replace_linear


@pytest.fixture
def slow_products(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(zoedepth.model.linear, "products_are_slow", lambda: True)


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


def test_gradients_and_other_precisions_take_the_way_of_torch(slow_products: None, monkeypatch: pytest.MonkeyPatch):
    network = nn.Sequential(nn.Linear(8, 12))
    replace_linear(network)
    monkeypatch.setattr(zoedepth.model.linear.F, "conv2d", None)
    x = torch.randn(3, 8)
    network(x).sum().backward()
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        assert network(x).dtype == torch.bfloat16
    with torch.no_grad():
        assert network.double()(x.double()).dtype == torch.float64


@torch.no_grad()
def test_a_model_keeps_its_depth_its_keys_and_its_file(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    torch.manual_seed(0)
    model = build_model(tiny_config).eval()
    save_model(model, tmp_path / "model.safetensors")
    monkeypatch.setattr(zoedepth.model.linear, "products_are_slow", lambda: True)
    other = load_model(tmp_path / "model.safetensors")
    assert any(isinstance(module, ConvolvedLinear) for module in other.modules())
    assert not any(isinstance(module, ConvolvedLinear) for module in model.modules())
    assert list(other.state_dict()) == list(model.state_dict())
    pixels = torch.rand(2, 3, 64, 96)
    assert torch.allclose(other(pixels).depth, model(pixels).depth, rtol=1e-5)
    save_model(other, tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == (tmp_path / "model.safetensors").read_bytes()


@pytest.mark.parametrize(
    ("about", "instructions", "slow"),
    [
        ("vendor_id\t: AuthenticAMD\n", None, True),
        ("vendor_id\t: GenuineIntel\n", None, False),
        ("vendor_id\t: GenuineIntel\n", "AVX2", True),
        ("vendor_id\t: GenuineIntel\n", "AVX512_E1", False),
    ],
)
def test_the_maker_of_the_processor_decides(
    about: str, instructions: str | None, slow: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Path, "read_text", lambda path: about)
    monkeypatch.setattr(torch.backends.mkl, "is_available", lambda: True)
    if instructions is None:
        monkeypatch.delenv("MKL_ENABLE_INSTRUCTIONS", raising=False)
    else:
        monkeypatch.setenv("MKL_ENABLE_INSTRUCTIONS", instructions)
    products_are_slow.cache_clear()
    assert products_are_slow() is slow
    monkeypatch.setattr(torch.backends.mkl, "is_available", lambda: False)
    products_are_slow.cache_clear()
    assert products_are_slow() is False
    products_are_slow.cache_clear()
