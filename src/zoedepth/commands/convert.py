"""``zoedepth convert SRC DST --to LAYOUT`` and ``zoedepth push MODEL REPO``."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from zoedepth.errors import InputError
from zoedepth.folders import check_writable


def convert(
    source: tyro.conf.Positional[str],
    target: tyro.conf.Positional[Path],
    *,
    to: Literal["zoedepth", "original", "huggingface"],
    name: str | None = None,
    licence: str | None = None,
    compat: tuple[str, ...] = (),
) -> int:
    """Write a model in another layout. The weights stay the same, bit by bit.

    The model is built once to check the weights, so that the result can be loaded. Weights that no model uses (an
    ImageNet classifier, a fusion unit without input) are dropped when read and filled in when written.

    Args:
        source: a name of `zoedepth models`, a file or folder of weights in any layout, or a Hugging Face id.
        target: folder to write; for original a file NAME.pt; for zoedepth a folder or a file NAME.safetensors.
        to: zoedepth (config.json and model.safetensors), original (isl-org/ZoeDepth's .pt) or huggingface (a folder for
            transformers).
        name: title of the model card; without it, the target's name.
        licence: licence of the weights, as the Hub writes it: mit, cc-by-nc-4.0 ...; without it, that of the source.
        compat: facts that the file does not hold, to be written into the config: 80m says that the weights of a
            baseline, or of the original with one head, are KITTI's.
    """
    from zoedepth.commands.progress import download_progress
    from zoedepth.presets import with_compat
    from zoedepth.weights.checkpoint import check_target, read_checkpoint, write_checkpoint
    from zoedepth.weights.fit import model_of
    from zoedepth.weights.load import find

    check_target(target, to=to)
    if target.is_file():
        raise InputError(f"{target} is there already: give another name, or remove it first")
    check_writable(target.parent, option="target")
    with download_progress() as progress:
        path = find(source, progress=progress)
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
    """Publish a model at the Hugging Face Hub, with a model card. Set HF_TOKEN, or run `hf auth login` once before.

    Args:
        source: a name of `zoedepth models`, or a file or folder of weights in any layout.
        repo: repository to publish in, owner/name; it is made if it does not exist.
        to: zoedepth, or huggingface for people who load it with transformers; this package loads both.
        private: make a new repository private.
        licence: licence of the weights, as the Hub writes it: mit, cc-by-nc-4.0 ...; without it, that of the source.
            Weights of which neither says one are not uploaded.
        dry_run: print the model card and upload nothing.
    """
    from zoedepth.commands.progress import download_progress
    from zoedepth.provenance import require_licence
    from zoedepth.weights.card import model_card
    from zoedepth.weights.checkpoint import read_checkpoint
    from zoedepth.weights.fit import model_of
    from zoedepth.weights.hub import is_hub_id
    from zoedepth.weights.load import find
    from zoedepth.weights.save import push_to_hub

    if not is_hub_id(repo):
        raise InputError(f"{repo!r} does not name a repository of the Hub: give owner/name")
    with download_progress() as progress:
        path = find(source, progress=progress)
    checkpoint = read_checkpoint(path)
    model = model_of(checkpoint, source=path)
    about = checkpoint.provenance.with_licence(licence)
    require_licence(about)
    if dry_run:
        card = model_card(
            checkpoint.config, name=repo, layout=to, licence=about.licence, trained_on=about.trained_on,
            metrics=about.measured,
        )  # fmt: skip
        print(card, end="")
        return 0
    print(push_to_hub(model, repo, to=to, private=private, licence=licence))
    return 0
