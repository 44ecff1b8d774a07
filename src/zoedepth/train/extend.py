"""Give a model heads for further domains, and larger ranges of depth."""

import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import nn

from zoedepth.build import build_model
from zoedepth.config import Domain, ModelConfig
from zoedepth.model.router import LabeledRouter
from zoedepth.model.zoedepth import ZoeDepth

_ROUND = (1, 2, 3, 5, 8, 10)


def head_of(config: ModelConfig, domain: str) -> str:
    """Return the name of the head that learns a domain of the data.

    A model with a single domain takes all photos, whatever their domain is called: it keeps its one head.
    """
    return config.domains[0].name if len(config.domains) == 1 else domain


def origin_of(config: ModelConfig, domain: str, metres: float) -> Domain:
    """Return the domain of a model whose head a domain of the data starts from.

    Args:
        config: the config of the model there is.
        domain: name of the domain of the data.
        metres: its farthest depth.
    """
    new = Domain(head_of(config, domain), min_depth=metres / 1000, max_depth=_round_up(metres))
    return config.domains[_most_like(new, config.domains)]


def extended_config(
    config: ModelConfig, far: Mapping[str, float], *, focal_px: Mapping[str, float] | None = None
) -> ModelConfig:
    """Return the config with a head for each domain of the data, reaching as far as the data does.

    What was fitted to the errors of the old weights (``Domain.std_factor``) is 1 again.

    Args:
        config: the config of the model there is.
        far: domain of the data → its farthest depth in metres, as the head learns it.
        focal_px: head → focal length of the photos that it learns from, unknown for a head that is left out; None
            leaves all heads what they have.
    """
    domains = {domain.name: domain for domain in config.domains}
    for name, metres in far.items():
        name = head_of(config, name)
        old = domains.get(name)
        if old is None or metres > old.max_depth:
            old = replace(old or Domain(name), max_depth=_round_up(metres))
        domains[name] = old if focal_px is None else replace(old, focal_px=focal_px.get(name))
    # All heads look at maps that training changes, so what was fitted to their errors holds for none.
    domains = {name: replace(domain, std_factor=1.0) for name, domain in domains.items()}
    return replace(config, domains=tuple(domains.values()))


def extended(model: ZoeDepth, config: ModelConfig) -> ZoeDepth:
    """Return a model of the extended config that starts with the weights of ``model``.

    A new domain starts with a copy of the head whose range is most like its own, and of that domain's row in the
    router's last layer. Of two equal scores the first wins, so the model predicts what it did before until training
    tells the two domains apart.
    """
    new = build_model(config).eval()
    new.provenance = model.provenance
    new.encoder.load_state_dict(model.encoder.state_dict())
    new.decoder.load_state_dict(model.decoder.state_dict())
    new.shared.load_state_dict(model.shared.state_dict())
    if new.convex is not None and model.convex is not None:
        new.convex.load_state_dict(model.convex.state_dict())
    old = model.config.domains
    origin = [_most_like(domain, old) for domain in config.domains]
    for head, index in zip(new.heads, origin, strict=True):
        head.load_state_dict(model.heads[index].state_dict())
    if not isinstance(model.router, LabeledRouter):
        _copy_router(model.router, new.router, origin)
    return new


def _most_like(domain: Domain, old: tuple[Domain, ...]) -> int:
    """Return the index of the domain with the same name, or else of the one with the nearest range."""
    names = [known.name for known in old]
    if domain.name in names:
        return names.index(domain.name)
    distances = [abs(math.log(domain.max_depth / known.max_depth)) for known in old]
    return distances.index(min(distances))


def _copy_router(old: nn.Module, new: nn.Module, origin: list[int]) -> None:
    """Copy the weights. The last layer has a row for each domain: row i comes from row ``origin[i]`` of the old one."""
    weights = old.state_dict()
    with torch.no_grad():
        for name, parameter in new.named_parameters():
            given = weights[name]
            parameter.copy_(given if given.shape == parameter.shape else given[origin])


def _round_up(metres: float) -> float:
    """Round up to 1, 2, 3, 5 or 8 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(metres))
    return next(step * power for step in _ROUND if step * power >= metres * (1 - 1e-9))
