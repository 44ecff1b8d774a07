"""Who reads a config: the parts of a model, each its own; the modules inside a part take plain values."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator

from torch import nn

import zoedepth.baselines
import zoedepth.model
from zoedepth.baselines import BASELINES, Baseline
from zoedepth.model.decoder import Decoder
from zoedepth.model.encoder import Encoder
from zoedepth.model.heads import HEADS
from zoedepth.model.zoedepth import ZoeDepth

PARTS = {
    ZoeDepth,
    Encoder,
    Decoder,
    Baseline,
    *BASELINES.values(),
    *(part for parts in HEADS.values() for part in parts),
}


def modules() -> Iterator[type[nn.Module]]:
    """Yield every module class of the model and of the baselines."""
    for package in (zoedepth.model, zoedepth.baselines):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(found.name)
            for kind in vars(module).values():
                if inspect.isclass(kind) and issubclass(kind, nn.Module) and kind.__module__ == found.name:
                    yield kind


def takes_a_config(kind: type[nn.Module]) -> bool:
    """Return True if a parameter of the constructor is a config. (A domain is a plain value.)"""
    return any("Config" in str(p.annotation) for p in inspect.signature(kind.__init__).parameters.values())


def test_only_the_parts_of_a_model_take_a_config():
    found = list(modules())
    assert len(found) > 50
    assert {kind for kind in found if takes_a_config(kind)} == PARTS
