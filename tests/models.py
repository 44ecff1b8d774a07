"""Random models for tests."""

import torch

from zoedepth.config import ModelConfig
from zoedepth.model.zoedepth import ZoeDepth


def random_model(config: ModelConfig, *, seed: int = 0) -> ZoeDepth:
    """Make a model in evaluation mode, the same for the same seed; the state of torch's random numbers stays.

    Its weights are twice as large as they begin: a new model gives nearly the same depth everywhere.
    """
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(seed)
        model = ZoeDepth(config).eval()
        for weight in model.parameters():
            if weight.ndim > 1:
                weight.mul_(2)
    return model
