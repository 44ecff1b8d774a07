"""Data sets of Hugging Face's library ``datasets``, from the Hub or from disk. None of their code is run."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from torch.utils.data import Dataset

from zoedepth.data.facts import Facts, asked_over, read_defaults
from zoedepth.data.sample import Sample, Target
from zoedepth.data.targets import to_sample
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import MAX_PIXELS, read_image_with_orientation
from zoedepth.stored import Memory, StoredMap, read_stored

if TYPE_CHECKING:
    import datasets

PHOTOS = ("image", "rgb")
"""Columns that may hold the photo."""

DEPTHS = ("depth_map", "depth")
"""Columns that may hold depth."""

_MAGIC = {b"\x89PNG": ".png", b"II*\0": ".tiff", b"MM\0*": ".tiff"}


def load_hub(repo: str, *, split: str, revision: str | None = None, config: str | None = None) -> "datasets.Dataset":
    """Load a split of a data set at the Hub, and download it if it is not in the cache.

    Args:
        repo: owner/name.
        split: its name, or a part of it as ``datasets`` writes it: train[:100].
        revision: branch, tag or commit.
        config: name of the configuration, where the data set has several.

    Raises:
        InputError: it cannot be downloaded or read.
        MissingExtraError: ``datasets`` is not installed.
    """
    library = _library()
    try:
        return library.load_dataset(repo, config, split=split, revision=revision)
    except Exception as error:  # the library raises nearly anything, also its dependencies' errors
        raise InputError(
            f"cannot load {split!r} of {repo} from Hugging Face: {error}. "
            "Check its name, your connection and your log-in"
        ) from error


def is_saved(folder: Path) -> bool:
    """Return True if ``save_to_disk`` wrote the folder."""
    return (folder / "dataset_dict.json").is_file() or all(
        (folder / name).is_file() for name in ("dataset_info.json", "state.json")
    )


def load_saved(folder: Path, *, split: str) -> "datasets.Dataset":
    """Load a folder that ``save_to_disk`` wrote. One without splits is the same for every split.

    Raises:
        InputError: it is damaged, or has no such split.
        MissingExtraError: ``datasets`` is not installed.
    """
    library = _library()
    try:
        loaded = library.load_from_disk(str(folder))
    except Exception as error:  # the library raises nearly anything on a folder that is another's
        raise InputError(f"cannot load the data set in {folder}: {error}") from error
    if not isinstance(loaded, library.DatasetDict):
        return loaded
    if split not in loaded:
        raise InputError(f"{folder} has the splits {sorted(map(str, loaded))}, and not {split!r}: choose one of them")
    return loaded[split]


class HuggingFaceDataset(Dataset[Sample]):
    """Rows with a photo and its depth, each as a ``Sample`` at its own size.

    A photo is an ``Image`` in the column ``image`` or ``rgb``. Depth is in ``depth_map`` or ``depth``: an array
    (height, width), or an ``Image``, PNG or TIFF, of one channel. Floats are metres, whole numbers
    need ``depth_scale``.

    Args:
        data: the rows.
        name: a name for them in messages and in the samples' names.
        depth_scale: the stored value of one metre, of floats too.
        domain: scene type of all photos.
        max_depth: the metres from which on depth is unknown.
        default_scale: the stored value of one metre for whole numbers of which nobody says it.
        folder: has the ``dataset.json`` that may say what the arguments do not.

    Raises:
        InputError: columns are missing or ambiguous, there are no rows, or nobody says the domain.
    """

    def __init__(
        self,
        data: "datasets.Dataset",
        *,
        name: str,
        depth_scale: float | None = None,
        domain: str | None = None,
        max_depth: float | None = None,
        default_scale: float | None = None,
        folder: Path | None = None,
    ) -> None:
        features = data.features
        for names in (PHOTOS, DEPTHS):
            if len(found := [column for column in names if column in features]) > 1:
                raise InputError(
                    f"{name} has the columns {' and '.join(found)}: it is not clear which is meant. Remove one of them "
                    "(remove_columns), and save it to disk"
                )
        photo, depth = (next((c for c in names if c in features), None) for names in (PHOTOS, DEPTHS))
        if photo is None or depth is None or not isinstance(features[photo], _library().Image):
            wanted = f"an Image in {' or '.join(PHOTOS)} and depth in {' or '.join(DEPTHS)}"
            raise InputError(f"{name} has the columns {sorted(features)}; it needs {wanted}")
        if not len(data):
            raise InputError(f"{name} has no rows")
        self.name = name
        defaults = read_defaults(folder) if folder else Facts()
        asked = asked_over(Facts(default_scale, domain, max_depth=max_depth), defaults, folder or "")
        self._facts = replace(asked, depth_scale=depth_scale)
        self._default_scale = asked.depth_scale
        self.max_depth = self._facts.max_depth
        """Metres from which on depth is unknown, where this is said."""
        if not self._facts.domain:
            raise InputError(f"{name} needs a domain: give ?domain=indoor behind its name, or in dataset.json")
        # The files' own bytes: formats and sizes are ours to check.
        self._photos = _undecoded(data.select_columns([photo]))
        self._depths = _undecoded(data.select_columns([depth]))
        self._columns = photo, depth

    def __len__(self) -> int:
        return len(self._photos)

    def __getitem__(self, index: int) -> Sample:
        """Read one row.

        Raises:
            InputError: a cell is damaged or empty, or photo and depth differ in size.
        """
        index = range(len(self))[index]
        photo, depth = self._columns
        names = tuple(f"{self.name}, row {index}, {column}" for column in self._columns)
        image, orientation = read_image_with_orientation(_file(self._photos[index][photo], names[0]))
        return to_sample(
            image,
            _stored(self._depths[index][depth], names[1]),
            kind="depth",
            facts=self._facts,
            default_scale=self._default_scale,
            orientation=orientation,
            name=f"{index:08d}",
            files=(names[0], names[1]),
        )

    @property
    def licence(self) -> str | None:
        """The licence of the data, where its card says it."""
        return self._photos.info.license or None

    @property
    def files(self) -> list[Path]:
        """The files that hold the rows."""
        return [Path(file["filename"]) for file in self._photos.cache_files]

    @property
    def domains(self) -> list[str]:
        """The domain of all rows, in a list."""
        return [self._facts.domain or ""]

    @property
    def kinds(self) -> list[Target]:
        """The kind of target, in a list: depth."""
        return ["depth"]


def _library() -> Any:
    try:
        import datasets
    except ImportError as error:
        raise MissingExtraError("hf", "a data set of Hugging Face") from error
    if int(datasets.__version__.split(".")[0]) < 4:  # these still ran a data set's own script
        raise MissingExtraError("hf", f"a data set of Hugging Face, with newer datasets than {datasets.__version__},")
    return datasets


def _undecoded(column: "datasets.Dataset") -> "datasets.Dataset":
    """Return a column whose images come as files, and arrays as arrays."""
    [(name, feature)] = column.features.items()
    image = _library().Image
    return column.cast_column(name, image(decode=False)) if isinstance(feature, image) else column.with_format("numpy")


def _file(cell: Any, name: str) -> Memory | Path:
    if isinstance(cell, dict) and cell.get("bytes"):
        return Memory(cell["bytes"], name, _MAGIC.get(cell["bytes"][:4], ""))
    path = cell.get("path") if isinstance(cell, dict) else None
    if not path or not Path(path).is_file():
        raise InputError(f"{name}: the cell is empty. Remove this row")
    return Path(path)


def _stored(cell: Any, name: str) -> StoredMap:
    if isinstance(cell, dict):
        return read_stored(_file(cell, name))
    values = np.asarray(cell)
    values = values[..., 0] if values.ndim == 3 and values.shape[-1] == 1 else values
    values = values[0] if values.ndim == 3 and values.shape[0] == 1 else values
    if values.ndim != 2 or values.dtype.kind not in "uif" or not 0 < values.size <= MAX_PIXELS:
        raise InputError(f"{name}: must be one map (height, width) of numbers; it is {values.dtype} {values.shape}")
    return StoredMap(values)
