"""``zoedepth convert SRC DST --to LAYOUT`` and ``zoedepth push MODEL REPO``."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from zoedepth.errors import InputError


def convert(
    source: tyro.conf.Positional[str],
    target: tyro.conf.Positional[Path],
    *,
    to: Literal["zoedepth", "original", "huggingface"],
    name: str | None = None,
    licence: str | None = None,
    compat: tuple[str, ...] = (),
) -> int:
    """Write a model in another layout, bit by bit the same weights.

    The model is built once from them and checked, so that what is written can be loaded. Weights that no model uses
    (an ImageNet classifier, a fusion unit without input) are dropped on the way in and made up on the way out.

    Args:
        source: a name of `zoedepth models`, a file or folder of weights of any layout, or a Hugging Face id.
        target: what to write: a folder; for the original a file NAME.pt; for zoedepth also a file NAME.safetensors.
        to: zoedepth (config.json and model.safetensors), original (isl-org/ZoeDepth's .pt) or huggingface (a folder for
            transformers).
        name: title of the model card; None: the target's name.
        licence: of the weights, for the model card, as the Hub writes it: mit, cc-by-nc-4.0 ...
        compat: what the file does not say, to be written into the config: 80m, a baseline's weights are KITTI's.
    """
    from zoedepth.presets import with_compat
    from zoedepth.weights.checkpoint import read_checkpoint, write_checkpoint
    from zoedepth.weights.load import find, model_of

    path = find(source)
    checkpoint = read_checkpoint(path)
    checkpoint = checkpoint._replace(config=with_compat(checkpoint.config, compat))
    model_of(checkpoint, source=path)
    written = write_checkpoint(checkpoint, target, to=to, name=name or target.stem, licence=licence)
    print(written)
    return 0


def push(
    source: tyro.conf.Positional[str],
    repo: tyro.conf.Positional[str],
    *,
    to: Literal["zoedepth", "huggingface"] = "zoedepth",
    private: bool = False,
    licence: str | None = None,
    dry_run: Annotated[bool, tyro.conf.arg(name="dry-run")] = False,
) -> int:
    """Publish a model at the Hugging Face Hub, with a model card. Needs HF_TOKEN, or `hf auth login` once.

    Args:
        source: a name of `zoedepth models`, a file or folder of weights of any layout.
        repo: owner/name; made if it is not there.
        to: zoedepth, or huggingface for people who load it with transformers; this package loads both.
        private: for a repository that is made.
        licence: of the weights, for the model card, as the Hub writes it: mit, cc-by-nc-4.0 ...
        dry_run: print the model card, and upload nothing.
    """
    from zoedepth.weights.card import model_card
    from zoedepth.weights.checkpoint import read_checkpoint
    from zoedepth.weights.hub import is_hub_id
    from zoedepth.weights.load import find, model_of, push_to_hub

    if not is_hub_id(repo):
        raise InputError(f"{repo!r} is no id of a repository: give owner/name")
    path = find(source)
    checkpoint = read_checkpoint(path)
    model = model_of(checkpoint, source=path)
    if dry_run:
        print(model_card(checkpoint.config, name=repo, layout=to, licence=licence))
        return 0
    print(push_to_hub(model, repo, to=to, private=private, licence=licence))
    return 0
