"""Open data to evaluate on, each set with the protocols under which it is scored."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from zoedepth.data.sample import DepthDataset
from zoedepth.datasets.published import PublishedDataset
from zoedepth.errors import InputError
from zoedepth.evaluation.identity import settings_fingerprint
from zoedepth.evaluation.protocols import PROTOCOLS, Protocol, protocol_of
from zoedepth.opening import open_dataset


@dataclass(frozen=True)
class EvaluationSet:
    """Photos with depth, and how they are scored."""

    dataset: DepthDataset
    protocols: Mapping[str, Protocol]
    """Domain → protocol, for every domain that occurs."""
    about: Mapping[str, object] = field(default_factory=dict)
    """Facts that tell it from others, e.g. where it is; a folder with scores of another set is refused."""
    state: Mapping[str, object] = field(default_factory=dict)
    """Facts that may change under the same name, e.g. a hash of its settings; scores are then made anew. What is said
    of the files of lists, folders, shards and published sets need not be said here."""


def open_evaluation_set(
    source: str | Path,
    *,
    name: str | None = None,
    protocol: Protocol | None = None,
    changes: Mapping[str, Any] | None = None,
    root: Path | None = None,
) -> EvaluationSet:
    """Open data and choose its protocols: the given one, else the paper's for a published set, else by domain.

    Args:
        source: a list, folder or address; see ``zoedepth.opening.open_dataset``.
        name: name of the data. That of a published data set, such as nyu, says how its official folder is read.
        protocol: for all domains of the data; None chooses.
        changes: fields of ``Protocol`` → values that replace those of the chosen protocols.
        root: the folder that the paths of a list are relative to; None takes that of the list.

    Raises:
        InputError: there is no such data, it holds disparity, or a changed protocol makes no sense.
    """
    use_masks = protocol is None or protocol.use_mask
    dataset = open_dataset(source, name=name, split="test", allow_missing=True, use_masks=use_masks, root=root)
    if "disparity" in dataset.kinds:
        raise InputError(f"{source} has disparity, which cannot be scored in metres: give data with depth")
    if protocol is None and name is not None and isinstance(dataset, PublishedDataset):
        protocol = PROTOCOLS.get(name)
    chosen = {domain: protocol or protocol_of(domain) for domain in dataset.domains}
    return EvaluationSet(
        dataset,
        {domain: replace(each, **(changes or {})) for domain, each in chosen.items()},
        {"data": str(source)},
        {"settings": settings_fingerprint(str(source), dataset)},
    )
