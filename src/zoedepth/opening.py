"""Open photos with depth in any form: ``open_dataset``."""

import re
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from zoedepth.data.facts import DEFAULTS_FILE, Facts, parse_facts
from zoedepth.data.folders import LAYOUTS, SPLITS, find_layout
from zoedepth.data.huggingface import HuggingFaceDataset, is_saved, load_hub, load_saved
from zoedepth.data.pairs import PairDataset, find_list
from zoedepth.data.sample import DepthDataset
from zoedepth.datasets import DATASETS
from zoedepth.errors import InputError
from zoedepth.shards.dataset import ShardDataset, find_shards
from zoedepth.shards.index import INDEX_FILE
from zoedepth.synthetic import SyntheticScenes

LISTS = (".csv", ".tsv", ".jsonl", ".txt")
"""Suffixes of lists of pairs."""

ACCEPTED = (
    "accepted are: a list of pairs (.csv, .tsv, .jsonl, .txt); a folder with SPLIT.csv or SPLIT.jsonl; a folder of "
    f"pairs ({', '.join('/ and '.join(layout) + '/' for layout in LAYOUTS)}); shards (a .tar, {INDEX_FILE}, their "
    "address, or a folder of them, also SPLIT/ in it); the official folder of a published data set, given as "
    f"NAME=FOLDER with NAME one of {', '.join(DATASETS)}; Hugging Face's data "
    "(hf:OWNER/NAME[@REVISION][:SPLIT][?domain=indoor], or a folder that save_to_disk wrote); rendered scenes "
    "(synthetic:rooms, synthetic:streets or synthetic:all, with [?n=1000&seed=0&size=288x384&fov=35-100])"
)

SCENES = {"rooms": ("indoor",), "streets": ("outdoor",), "all": ("indoor", "outdoor")}
"""Name of rendered scenes → their domains."""

_HUB = re.compile(r"(?P<repo>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+))?(?::(?P<split>[^:?]+(?::[^?]*)?))?")


def open_dataset(
    source: str | Path,
    *,
    name: str | None = None,
    split: str = "train",
    allow_missing: bool = False,
    depth_scale: float | None = None,
    domain: str | None = None,
    max_depth: float | None = None,
    root: str | Path | None = None,
    keep_missing: bool = False,
    use_masks: bool = True,
) -> DepthDataset:
    """Open photos with depth, wherever and however they are kept.

    Args:
        source: a file, folder or address; see ``ACCEPTED``, or docs/your-data.md.
        name: the name of the data. The name of a published data set, such as nyu, tells how to read its official
            folder, unless a list, an index or saved data in the folder shows that it is your own.
        split: which list, folder or split to take, where there are several.
        allow_missing: accept photos without depth, where the format can say that there is none.
        depth_scale: the stored value of one metre, for whole numbers of which the data does not say it.
        domain: scene type, where the data does not say it; it replaces that of dataset.json.
        max_depth: the metres from which on depth is unknown, where the data does not say it; it replaces those of
            dataset.json.
        root: the folder that the paths of a list are relative to; None takes that of the list. Data of other forms has
            no use for it.
        keep_missing: accept pairs whose files are missing. Reading them is an error, and ``missing_files`` of the data
            set lists them.
        use_masks: False ignores a published set's own masks, see ``zoedepth.datasets.published.PublishedDataset``.

    Raises:
        InputError: there is no such data, or it is damaged; the message says what is accepted.
        MissingExtraError: it needs a library that is not installed.
    """
    text = str(source)
    scheme = text.partition(":")[0]
    given = {"depth_scale": depth_scale, "domain": domain, "max_depth": max_depth}
    pairs = {"allow_missing": allow_missing, "keep_missing": keep_missing, "root": root}
    if scheme == "hf":
        return _open_hub(text, split=split, facts=Facts(depth_scale, domain, max_depth=max_depth))
    if scheme == "synthetic":
        return _open_synthetic(text)
    if scheme in ("http", "https"):
        if not text.startswith(f"{scheme}://") or not text.endswith((f"/{INDEX_FILE}", ".tar")):
            raise InputError(f"cannot open {text}: the address must be that of {INDEX_FILE} or a .tar; {ACCEPTED}")
        return ShardDataset(text, **given)
    path = Path(source)
    if path.is_dir() and name in DATASETS and not use_masks:
        return DATASETS[name](path, split=split, allow_missing=allow_missing, use_masks=False)
    if path.is_dir():
        return _open_folder(path, name=name, split=split, given=given, pairs=pairs)
    if not path.is_file():
        raise InputError(f"there is no {path}; {ACCEPTED}")
    if path.suffix.lower() in LISTS:
        return PairDataset(path, **pairs, **given)
    if path.suffix == ".tar" or path.name == INDEX_FILE:
        return ShardDataset(path, **given)
    raise InputError(f"{path} is not data in a known format; {ACCEPTED}")


def _open_folder(
    path: Path, *, name: str | None, split: str, given: dict[str, Any], pairs: dict[str, Any]
) -> DepthDataset:
    shards = path / split if (path / split / INDEX_FILE).is_file() else path
    if find_list(path, split):
        return PairDataset(path, split=split, **pairs, **given)
    if (shards / INDEX_FILE).is_file():
        if shards != path and (path / DEFAULTS_FILE).is_file() and not (shards / DEFAULTS_FILE).is_file():
            raise InputError(f"{path / DEFAULTS_FILE} is not beside the shards that it may be of: move it to {shards}")
        return ShardDataset(shards, **given)
    if is_saved(path):
        data = load_saved(path, split=split)
        given = {**given, "depth_scale": None, "default_scale": given["depth_scale"]}
        return HuggingFaceDataset(data, name=str(path), **given, folder=path)
    if name in DATASETS:
        return DATASETS[name](
            path, split=split, allow_missing=pairs["allow_missing"], keep_missing=pairs["keep_missing"]
        )
    if lists := [found for other in SPLITS if (found := find_list(path, other))]:
        raise InputError(
            f"{path} has {lists[0].name}, and no {split}.csv or {split}.jsonl: give the list itself, {lists[0]}, if "
            f"you want its photos, or add a list of the split {split}"
        )
    if find_layout(path):
        return PairDataset(path, split=split, **pairs, **given)
    if find_shards(path):
        return ShardDataset(path, **given)
    looked = f"{split}.csv, {split}.jsonl, {INDEX_FILE}, tar files, folders of photos and depth"
    published = "" if name is None else f", and {name!r} is no published data set"
    raise InputError(f"{path} has none of {looked}{published}; {ACCEPTED}")


def _open_hub(text: str, *, split: str, facts: Facts) -> DepthDataset:
    address, options = _options(text, {"domain", "depth_scale", "max_depth", "config"})
    if not (found := _HUB.fullmatch(address)):
        raise InputError(f"cannot open {text}: write it as hf:OWNER/NAME[@REVISION][:SPLIT]; {ACCEPTED}")
    said = parse_facts(options, f"cannot open {text}")
    both = said.over(facts)
    data = load_hub(
        found["repo"], split=found["split"] or split, revision=found["revision"], config=options.get("config")
    )
    return HuggingFaceDataset(
        data,
        name=f"hf:{address}",
        depth_scale=said.depth_scale,
        domain=both.domain,
        max_depth=both.max_depth,
        default_scale=facts.depth_scale,
    )


def _open_synthetic(text: str) -> DepthDataset:
    address, options = _options(text, {"n", "seed", "size", "fov"})
    if address not in SCENES:
        raise InputError(f"cannot open {text}: the scenes are {', '.join(SCENES)}; {ACCEPTED}")
    numbers = re.fullmatch(
        r"(\d{1,9}) (\d{1,9}) (\d{1,5})x(\d{1,5})",
        " ".join(options.get(name, usual) for name, usual in (("n", "10000"), ("seed", "0"), ("size", "288x384"))),
    )
    if not numbers:
        raise InputError(f"cannot open {text}: n and seed must be whole numbers, and size HEIGHTxWIDTH")
    n, seed, height, width = map(int, numbers.groups())
    lens = re.fullmatch(r"(\d{1,3}(?:\.\d+)?)(?:-(\d{1,3}(?:\.\d+)?))?", options.get("fov", "0"))
    if not lens:
        raise InputError(f"cannot open {text}: fov must be degrees across the picture, such as 60 or 35-100")
    fov = None if "fov" not in options else (float(lens[1]), float(lens[2] or lens[1]))
    return SyntheticScenes(n, size=(height, width), seed=seed, domains=SCENES[address], fields_of_view=fov)


def _options(text: str, known: set[str]) -> tuple[str, dict[str, str]]:
    """Return the text between the scheme and the question mark, and the options after it."""
    address, _, query = text.partition(":")[2].partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    if unknown := sorted(set(options) - known):
        raise InputError(f"cannot open {text}: it has no options {unknown}; it has {sorted(known)}")
    return address, options
