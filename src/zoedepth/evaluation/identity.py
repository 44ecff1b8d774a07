"""Tell whether kept scores still hold: the state of weights, photos, depth maps and settings when they were made.

The first line of a file of scores says which question they answer (``about``); each score has a stamp of everything
that may have changed since under the same names. Weights and settings are known by their content, the many files of a
data set by their sizes and times.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from zoedepth import __version__
from zoedepth.data.facts import DEFAULTS_FILE
from zoedepth.data.huggingface import HuggingFaceDataset
from zoedepth.data.lists import Pair
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Samples
from zoedepth.datasets.published import PublishedDataset
from zoedepth.shards.dataset import ShardDataset
from zoedepth.weights.fingerprint import content, files_state, fingerprint

_SCORING = 2
"""Number that grows when the same protocol scores other pixels than it did: kept scores are made anew then."""


def settings_fingerprint(source: str, dataset: Samples | None = None) -> str | None:
    """Return a hash of ``dataset.json`` in a folder of data or beside a list; None where there is no such file.

    Args:
        source: where the data is, as it was given.
        dataset: the data; shards may lie in a folder below the one that was given.
    """
    path = dataset.folder if isinstance(dataset, ShardDataset) else Path(source)
    settings = (path if path.is_dir() else path.parent) / DEFAULTS_FILE
    return content(settings) if settings.is_file() else None


def said_and_files(dataset: Samples, source: str) -> Iterator[tuple[list[object], list[Path]]]:
    """Yield what is said of the samples of a data set, and their files: pair by pair where it has pairs.

    Data that has no files, such as rendered scenes, yields nothing: it is known by its address.

    Args:
        dataset: the data set.
        source: where it is, as it was given.
    """
    if isinstance(dataset, PairDataset | PublishedDataset):
        for pair in dataset.pairs:
            facts = [pair.kind, pair.scale, pair.domain, pair.max_depth, pair.camera] if isinstance(pair, Pair) else []
            yield list(facts), list(pair.files)
    elif isinstance(dataset, ShardDataset):
        yield [dataset.index.to_json()], dataset.files
    elif isinstance(dataset, HuggingFaceDataset):
        yield [file.parent.name for file in dataset.files], dataset.files  # the folder's name has the revision
    elif Path(source).exists():
        yield [], sorted(Path(source).rglob("*")) if Path(source).is_dir() else [Path(source)]


class Stamps:
    """Make the stamps of a source's scores on a data set: the same as long as everything they depend on is.

    Args:
        source: the source of predictions. If it has a method ``state``, that is given the name of a photo, and returns
            plain values that change when the prediction may.
        data: the data set. Of a list, a folder or a published set each image has its own files; of others, which have
            them in an attribute ``files``, every image depends on all.
        state: plain values that change when the scores may.
    """

    def __init__(self, source: object, data: Samples, state: Mapping[str, object]) -> None:
        self._of_source: Callable[[str], object] | None = getattr(source, "state", None)
        self._pairs = data.pairs if isinstance(data, PairDataset | PublishedDataset) else None
        self._n_images = len(data)
        self._common = fingerprint([__version__, _SCORING, dict(state), files_state(getattr(data, "files", ()))])

    def of_data(self, index: int) -> str:
        """Return the state of an image of the data set and of what all scores depend on; "" for no such image."""
        if not 0 <= index < self._n_images:
            return ""
        if self._pairs is None:
            return self._common
        pair = self._pairs[index]
        return fingerprint([self._common, repr(pair), files_state(pair.files)])

    def of(self, index: int, name: str, *, data: str | None = None) -> str:
        """Return the stamp of a score.

        Args:
            index: number of the image in the data set.
            name: name of the photo.
            data: result of ``of_data`` before the image was read; None asks for it now.
        """
        source = None if self._of_source is None else self._of_source(name)
        return fingerprint([data or self.of_data(index), name, source])
