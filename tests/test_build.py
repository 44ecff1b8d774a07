"""The one way from a config to a network."""

import ast
import copy
import io
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.baselines.base import build
from tests.baselines.test_baseline import CONFIGS
from tests.model.heads import test_adabins, test_bts, test_dorn, test_naive, test_newcrfs, test_pixelbins, test_splitter

from zoedepth.baselines import BASELINES
from zoedepth.build import build_model, without_memory
from zoedepth.config import BaselineConfig, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model import timm_encoder
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.presets import BASELINES as BASELINE_PRESETS
from zoedepth.presets import PRESETS
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

SOURCE = Path(__file__).parents[1] / "src/zoedepth"


def formats(model: torch.nn.Module) -> set[bool]:
    """Whether the weights of convolutions lie channels last (True for those of one channel or pixel, too)."""
    weights = [value for value in model.parameters() if value.ndim == 4]
    return {value.is_contiguous(memory_format=torch.channels_last) for value in weights}


def test_a_config_becomes_its_network_in_training_mode(tiny_config: ModelConfig):
    model = build_model(tiny_config)
    assert type(model) is ZoeDepth
    assert model.config == tiny_config
    assert model.training
    assert formats(model) == {True}


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: type(config.network).__name__)
def test_a_config_of_a_baseline_becomes_the_baseline(config: BaselineConfig):
    with without_memory():
        model = build_model(config)
    assert type(model) is BASELINES[type(config.network)]
    assert model.config == config


@pytest.mark.parametrize("kind", ["zoedepth", "baseline"])
def test_without_memory_there_are_the_same_weights_but_their_values(kind: str, tiny_config: ModelConfig):
    config = tiny_config if kind == "zoedepth" else CONFIGS[0]
    model = build_model(config)
    with without_memory():
        empty = build_model(config)
        assert torch.ones(1, device="cpu").mul_(2) == 2, "what has memory is changed as ever"
    assert all(value.is_meta for value in empty.state_dict().values())
    shapes = [
        {name: (value.shape, value.dtype) for name, value in each.state_dict().items()} for each in (model, empty)
    ]
    assert shapes[0] == shapes[1]
    assert not any(value.is_meta for value in build_model(config).state_dict().values()), "the context has ended"


def test_built_and_loaded_models_are_made_of_the_same_layers(tiny_config: ModelConfig, tmp_path: Path):
    model = build_model(tiny_config)
    save_model(model, tmp_path / "model.safetensors")
    loaded = load_model(tmp_path / "model.safetensors")
    assert [type(module) for module in loaded.modules()] == [type(module) for module in model.modules()]
    assert formats(loaded) == formats(model)


def test_nothing_else_in_the_package_builds_a_network():
    """Or one way would forget what another does to a model."""
    found = {
        f"{path.name}: {node.func.value.id if isinstance(node.func, ast.Subscript) else node.func.id}"
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func).partition("[")[0] in ("ZoeDepth", "BASELINES")
    }
    assert found == {"build.py: ZoeDepth", "build.py: BASELINES"}


ONE_OF_EACH = {
    name: (PRESETS | BASELINE_PRESETS)[name]
    for name in ("zoed-m12-nk", "zoed-m12-n-swin-l", "zoed-m12-n-swin2-t", "zoed-m12-n-efficientnet-b5", "zoed-lite",
                 "adabins-n", "bts-n", "dorn-n", "localbins-n", "newcrfs-n", "pixelbins-n")
}  # fmt: skip
"""A model with each kind of encoder, and each baseline."""


class TestPickling:
    """Python sends models to other processes by pickle, and ``torch.save(model)`` writes one."""

    @pytest.mark.parametrize("name", ONE_OF_EACH)
    def test_every_network_comes_back_in_a_process_that_has_built_none(self, name: str):
        with without_memory():
            model = build_model(ONE_OF_EACH[name])
        content = pickle.dumps(model)
        assert [type(x) for x in copy.deepcopy(model).modules()] == [type(x) for x in model.modules()]
        # A new process has not made the classes that derive from timm's.
        timm_encoder.specialised.cache_clear()
        back = pickle.loads(content)
        assert [type(module).__name__ for module in back.modules()] == [type(x).__name__ for x in model.modules()]

    def test_depth_stays_the_same_in_a_file_of_torch_and_in_a_predictor(self):
        predictor = Predictor(load_model("zoed-lite"))
        photo = np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)
        file = io.BytesIO()
        torch.save(predictor.model, file)
        file.seek(0)
        expected = predictor(photo).depth
        assert np.array_equal(pickle.loads(pickle.dumps(predictor))(photo).depth, expected)
        assert np.array_equal(Predictor(torch.load(file, weights_only=False))(photo).depth, expected)


def check_other_number_types(model: DepthModel, size: tuple[int, int]) -> None:
    """Check that depth is float32 and right when the weights, the pixels or torch's default have another type."""
    pixels = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    expected = model(pixels, return_std=True)
    for dtype, tolerance in ((torch.float16, 2e-3), (torch.bfloat16, 2e-2), (torch.float64, 1e-5)):
        other = copy.deepcopy(model).to(dtype)
        for given in (pixels, pixels.to(dtype)):
            found = other(given, return_std=True)
            assert found.depth.dtype == torch.float32
            assert ((found.depth - expected.depth).abs() / expected.depth).mean() < tolerance
            assert found.std is None or found.std.dtype == torch.float32
        # The pixels are rounded before they reach the model, and nothing else is.
        found = model(pixels.to(dtype))
        torch.testing.assert_close(found.depth, model(pixels.to(dtype).float()).depth, rtol=1e-4, atol=1e-5)
    torch.set_default_dtype(torch.float64)
    try:
        torch.testing.assert_close(model(pixels).depth, expected.depth, rtol=1e-4, atol=1e-5)
    finally:
        torch.set_default_dtype(torch.float32)


class TestOtherNumberTypes:
    @torch.no_grad()
    @pytest.mark.parametrize("config", CONFIGS, ids=lambda config: type(config.network).__name__)
    def test_baselines(self, config: BaselineConfig):
        check_other_number_types(build(config), config.size)

    @torch.no_grad()
    @pytest.mark.parametrize("classifier", ["mlp", "transformer"])
    def test_routers(self, classifier: str, tiny_config: ModelConfig):
        torch.manual_seed(0)
        model = build_model(replace(tiny_config, router=replace(tiny_config.router, classifier=classifier)))
        check_other_number_types(model.eval(), (64, 96))

    @torch.no_grad()
    @pytest.mark.parametrize(
        "head", [test_adabins, test_bts, test_dorn, test_naive, test_newcrfs, test_pixelbins, test_splitter]
    )
    def test_heads(self, head, tiny_config: ModelConfig):
        torch.manual_seed(0)
        check_other_number_types(build_model(replace(tiny_config, head=head.TINY)).eval(), (64, 96))

    @pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
    def test_photos_of_a_predictor(self, dtype: torch.dtype, tiny_model: ZoeDepth):
        photo = np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)
        expected = Predictor(tiny_model)(photo).depth
        found = Predictor(tiny_model.to(dtype))(photo).depth
        assert found.dtype == np.float32
        assert np.abs(found / expected - 1).mean() < 0.02

    def test_built_while_torchs_default_is_double(self, tmp_path: Path, tiny_model: ZoeDepth):
        pixels = torch.rand(1, 3, 64, 64)
        save_model(tiny_model, tmp_path / "model.safetensors")
        torch.set_default_dtype(torch.float64)
        try:
            model = load_model(tmp_path / "model.safetensors")
        finally:
            torch.set_default_dtype(torch.float32)
        assert model.dtype == torch.float32
        torch.testing.assert_close(model(pixels).depth, tiny_model(pixels).depth)

    def test_pixels_on_another_device(self, tiny_model: ZoeDepth):
        with pytest.raises(InputError, match="pixels are on meta and the model is on cpu: move one"):
            tiny_model(torch.rand(1, 3, 64, 64, device="meta"))
