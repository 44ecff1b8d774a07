"""``ZoeDepth.from_pretrained``: put on the class here, because model/ imports nothing that is above it."""

from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.exported import is_exported
from zoedepth.weights.load import load_model

__all__ = ["ZoeDepth", "load_zoedepth"]


def load_zoedepth(name_or_path: str | Path) -> ZoeDepth:
    """Load a ZoeDepth. This is ``ZoeDepth.from_pretrained``; ``load_model`` loads every kind of model.

    Args:
        name_or_path: see ``load_model``.

    Raises:
        InputError: see ``load_model``; or the model is an exported file or one of the baselines.
    """
    model = load_model(name_or_path)
    if not isinstance(model, ZoeDepth):
        kind = "an exported model" if is_exported(name_or_path) else "one of the baselines"
        raise InputError(f"{name_or_path} is {kind}, not a ZoeDepth: load it with zoedepth.load_model")
    return model


ZoeDepth.from_pretrained = staticmethod(load_zoedepth)  # ``from zoedepth import ZoeDepth`` comes by this module
