"""Fit the factor on a model's standard deviations to photos that no training has seen, and keep it in the model.

    python -m scripts.fit_std --model MODEL --out FILE --data fresh="synthetic:all?n=120&seed=4242&fov=50-90"

A training ties the deviation to the errors on its own photos; on others errors are larger. Each domain gets the factor
that makes the root mean square of error / deviation 1, and with it the share of pixels within one deviation is printed.
"""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from benchmarks.doubt import predict_scored

from zoedepth import load_model, save_model
from zoedepth.commands.data import named_paths
from zoedepth.errors import InputError
from zoedepth.evaluation.evaluation_set import open_evaluation_set
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.uncertainty import fit_std_factor


def main(
    *,
    model: str,
    out: Path,
    data: tuple[str, ...],
    camera: Literal["data", "none"] = "data",
    dtype: Literal["float16", "float32"] = "float32",
) -> None:
    """Measure errors, and write the model with its factors.

    Args:
        model: a name of `zoedepth models`, or a file of weights.
        out: the file to write.
        data: NAME=LIST of photos with depth that the model has not been trained on, as `zoedepth evaluate` takes them.
        camera: as in `zoedepth evaluate`.
        dtype: type of the weights in the file.
    """
    if out.exists():
        raise InputError(f"{out} is there already: give --out another file")
    loaded = load_model(model)
    source = ModelSource(loaded, camera=camera)
    errors: dict[str, list[np.ndarray]] = defaultdict(list)
    for path in named_paths(data).values():
        photos = open_evaluation_set(path)
        for index in range(len(photos.dataset)):
            depth, std, truth, domain = predict_scored(source, photos, index)
            if len(depth):
                errors[domain].append(np.abs(depth - truth) / std)
    domains = loaded.config.domains
    if missing := [domain.name for domain in domains if domain.name not in errors]:
        raise InputError(f"no photo of known depth went to {missing}: give photos of every domain of the model")
    fitted = []
    for domain in domains:
        of_domain = errors[domain.name]
        factor = fit_std_factor(of_domain)
        before, after = (np.mean([np.mean(error <= within) for error in of_domain]) for within in (1.0, factor))
        fitted.append(replace(domain, std_factor=round(domain.std_factor * factor, 3)))
        print(f"{domain.name}: {len(of_domain)} photos, std_factor {fitted[-1].std_factor:g}, "
              f"within one std {before:.1%}, then {after:.1%}")  # fmt: skip
    loaded.config = replace(loaded.config, domains=tuple(fitted))
    save_model(loaded, out, dtype=torch.float16 if dtype == "float16" else torch.float32)


if __name__ == "__main__":
    tyro.cli(main)
