"""The optimizer: its groups of parameters, and their rates as pure functions of the step."""

import math
from fnmatch import fnmatch

import torch
from torch import nn
from torch.optim import SGD, AdamW, Optimizer

from zoedepth.train.config import OptimConfig


def build_optimizer(model: nn.Module, config: OptimConfig) -> Optimizer:
    """Build the optimizer, with one group each for encoder, position tables, decoder, and heads with router.

    A group's rate is ``config.learning_rate`` times its factor, which the group keeps as ``factor``. A group whose
    factor is 0 is frozen, and so are the parameters that ``config.frozen`` names. The reassembling part of the decoder
    belongs to the encoder's group, as released.
    """
    factors = {
        "encoder": config.encoder_factor,
        "position": config.position_factor,
        "decoder": config.decoder_factor,
        "head": 1.0,
    }
    groups: dict[str, list[nn.Parameter]] = {name: [] for name in factors}
    for name, parameter in model.named_parameters():
        group = _group(name)
        if factors[group] == 0 or any(fnmatch(name, pattern) for pattern in config.frozen):
            parameter.requires_grad_(False)
        elif parameter.requires_grad:
            groups[group].append(parameter)
    decayed = {"encoder", "position"} if config.decay_encoder_only else groups.keys()
    described = [
        {
            "params": parameters,
            "lr": config.learning_rate * factors[name],
            "weight_decay": config.weight_decay if name in decayed else 0.0,
            "factor": factors[name],
            "name": name,
        }
        for name, parameters in groups.items()
        if parameters
    ]
    if config.optimizer == "sgd":
        return SGD(described, momentum=config.momentum[1])
    return AdamW(described, betas=(config.momentum[1], 0.999), eps=config.eps)


def _group(name: str) -> str:
    if "position_tables" in name or "relative_position" in name:
        return "position"
    if name.startswith(("encoder.", "decoder.reassemble.")):
        return "encoder"
    return "decoder" if name.startswith("decoder.") else "head"


def one_cycle(step: int, steps: int, config: OptimConfig) -> tuple[float, float]:
    """Return (rate as a factor of the highest, first beta) at a step: torch's ``OneCycleLR`` with cosine annealing."""
    first, last = 1 / config.initial_division, 1 / (config.initial_division * config.final_division)
    low, high = config.momentum
    peak = config.warmup * steps - 1
    if step <= peak:
        progress = step / peak if peak > 0 else 1.0
        return _anneal(first, 1.0, progress), _anneal(high, low, progress)
    progress = (step - peak) / (steps - 1 - peak)
    return _anneal(1.0, last, progress), _anneal(low, high, progress)


def set_rates(optimizer: torch.optim.Optimizer, step: int, steps: int, config: OptimConfig) -> None:
    """Give every group its rate and momentum for this step."""
    if config.schedule == "one-cycle":
        factor, beta = one_cycle(step, steps, config)
    else:
        factor, beta = polynomial(step, steps, config) if config.schedule == "polynomial" else 1.0, config.momentum[1]
    for group in optimizer.param_groups:
        group["lr"] = config.learning_rate * group["factor"] * factor
        if "betas" in group:
            group["betas"] = (beta, group["betas"][1])
        else:
            group["momentum"] = beta


def polynomial(step: int, steps: int, config: OptimConfig) -> float:
    """Return the rate as a factor of the highest: it falls from 1 to ``1 / final_division`` (BTS ``bts_main.py``)."""
    last = 1 / config.final_division
    return last + (1 - last) * (1 - step / steps) ** 0.9


def _anneal(start: float, end: float, progress: float) -> float:
    """Go from start to end along half a cosine; progress is 0 to 1."""
    return end + (start - end) / 2 * (1 + math.cos(math.pi * progress))
