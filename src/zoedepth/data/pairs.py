"""Photos with depth as files: the formats for your own data.

A list, with paths relative to its folder or to another. CSV has one line a pair::

    image,depth,depth_scale,domain
    image/0001.jpg,depth/0001.png,1000,indoor

``depth`` is a 16-bit PNG or PGM, metres = value / ``depth_scale``, 0 where unknown; or an .npy, .npz, .exr, .tiff or
.pfm, where floating point is metres and needs no ``depth_scale``. A PNG that this package wrote says its own scale.
``disparity`` in place of ``depth`` is inverse depth up to an unknown scale and shift, for stage 1, where the domain may
be left out. Two more are optional: ``mask`` (a PNG, not zero where the target is valid) and ``fx,fy,cx,cy`` (the camera
at the size of the photo, pixels; the centre of the top left pixel is at (0, 0)). Other columns are ignored.

JSON Lines (.jsonl) has an object with the same keys in each line; ``rgb`` may stand for ``image``, and ``cam_in`` for
the list [fx, fy, cx, cy]. Text lists (.txt) have lines ``photo depth focal`` or ``time photo time depth``. Folders need
no list at all, see ``zoedepth.data.folders.find_pairs``. ``zoedepth.data.tables``, ``text_lists`` and ``names`` tell
what is read as what.

Facts that hold for all pairs may stand once in ``dataset.json`` beside the list or in the folder:
``{"depth_scale": 1000, "domain": "indoor"}``, also with ``fx`` to ``cy``.
"""

import os
from pathlib import Path

from torch.utils.data import Dataset

from zoedepth.data.facts import Facts, asked_over, camera_of_photo, read_defaults
from zoedepth.data.folders import find_layout, find_pairs
from zoedepth.data.lists import Pair, read_list
from zoedepth.data.names import other_capitals
from zoedepth.data.sample import Sample, Target
from zoedepth.data.targets import to_sample
from zoedepth.errors import InputError
from zoedepth.images import read_image_with_orientation
from zoedepth.stored import read_mask, read_stored

__all__ = ["Pair", "PairDataset", "find_list"]


def find_list(folder: Path, split: str) -> Path | None:
    """Return the list of a split in a folder, ``<split>.csv`` or ``<split>.jsonl``; None where there is neither.

    Raises:
        InputError: there are both.
    """
    found = [path for suffix in ("csv", "jsonl") if (path := folder / f"{split}.{suffix}").is_file()]
    if len(found) > 1:
        raise InputError(f"{folder} has both {found[0].name} and {found[1].name}: give one of the lists by its name")
    return found[0] if found else None


class PairDataset(Dataset[Sample]):
    """The pairs of a list or a folder, each as a ``Sample`` at its own size.

    Args:
        path: a list (.csv, .tsv, .jsonl, .txt), a folder with a list named after the split, or a folder of pairs
            without one.
        split: name of the list without suffix, or of the folders below those of photos and depth.
        allow_missing: accept a photo without depth ("None" in a list) as one without truth, as KITTI's test list has
            them; otherwise it is an error, because nothing can be learned from it.
        depth_scale: the stored value of one metre, for files of which nobody says it.
        domain: scene type, for pairs of which no list says it.
        max_depth: the metres from which on depth is unknown, for pairs of which no list says it.
        root: the folder that the paths of a list are relative to; None takes that of the list.
        keep_missing: accept pairs whose files are missing; ``missing_files`` lists these, and reading them is an error.

    Raises:
        InputError: a list is missing or malformed (the line is named), or files are missing.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "train",
        allow_missing: bool = False,
        depth_scale: float | None = None,
        domain: str | None = None,
        max_depth: float | None = None,
        root: str | Path | None = None,
        keep_missing: bool = False,
    ) -> None:
        path = Path(path)
        folder = path if path.is_dir() else path.parent
        defaults = asked_over(Facts(depth_scale, domain, max_depth=max_depth), read_defaults(folder), folder)
        self._default_scale = defaults.depth_scale
        self.max_depth = defaults.max_depth
        """Metres from which on depth is unknown, where this is said for all pairs."""
        found = find_list(path, split) if path.is_dir() else path
        self._root = folder if root is None else Path(root)
        if found is None and find_layout(path):
            self._root = path
            self.path = path
            self.pairs = find_pairs(
                path, split=split, defaults=defaults, allow_missing=allow_missing, keep_missing=keep_missing
            )
        else:
            self.path = found or path / f"{split}.csv"
            if not self.path.is_file():
                columns = "image,depth,depth_scale,domain"
                raise InputError(f"there is no {self.path}: give a CSV file with the columns {columns}")
            # Whoever names the list itself trusts it, and may have it anywhere.
            self.pairs = read_list(self.path, defaults, root=self._root, anywhere=not path.is_dir())
        if not allow_missing and (bare := [pair.image for pair in self.pairs if pair.target is None]):
            raise InputError(
                f"{self.path} lists {len(bare)} photos without depth, the first is {bare[0]}. Remove their lines"
            )
        if not keep_missing and (missing := self.missing_files()):
            twin = other_capitals(missing[0])
            hint = f". There is {twin.name}: capital letters count" if twin else ""
            raise InputError(
                f"{self.path} lists {len(missing)} files that do not exist, the first is {missing[0]}{hint}. Its paths "
                f"are relative to {self._root}{'' if root else ', its own folder; --root names another'}"
            )

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> Sample:
        """Read one pair.

        Raises:
            InputError: a file is damaged, or photo, target and mask differ in size.
            MissingExtraError: a format needs a library that is not installed.
        """
        pair = self.pairs[index]
        photo, orientation = read_image_with_orientation(pair.image)
        camera = camera_of_photo(pair.camera, (photo.shape[0], photo.shape[1]))
        return to_sample(
            photo,
            None if pair.target is None else read_stored(pair.target),
            kind=pair.kind,
            facts=Facts(pair.scale, pair.domain, camera, pair.max_depth or self.max_depth),
            default_scale=self._default_scale,
            mask=None if pair.mask is None else read_mask(pair.mask),
            name=self.name_of(index),
            orientation=orientation,
            files=(pair.image, pair.target),
        )

    def name_of(self, index: int) -> str:
        """Return the name of a sample: its photo's path below the root."""
        return _name(self.pairs[index].image, self._root)

    @property
    def domains(self) -> list[str]:
        """The domains that occur."""
        return sorted({pair.domain for pair in self.pairs})

    @property
    def kinds(self) -> list[Target]:
        """The kinds of target that occur."""
        return sorted({pair.kind for pair in self.pairs})

    def missing_files(self) -> list[Path]:
        """List the files of all pairs that do not exist."""
        return [path for pair in self.pairs for path in pair.files if not _exists(path)]


def _name(photo: Path, root: Path) -> str:
    """Return the path of a photo below the root; all of its path, without the first slash, where it is elsewhere."""
    if photo.is_relative_to(root) and ".." not in (name := photo.relative_to(root)).parts:
        return str(name)
    photo = Path(os.path.abspath(photo))
    return str(photo.relative_to(photo.anchor))


def _exists(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False
