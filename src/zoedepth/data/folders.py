"""Folders of pairs without a list: photos in one folder, depth in another, matched by their names."""

import os
from pathlib import Path, PurePath

from zoedepth.data.facts import DEFAULTS_FILE, Facts
from zoedepth.data.lists import Pair, check_unit
from zoedepth.errors import InputError
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.stored import DEPTH_SUFFIXES

LAYOUTS = (("rgb", "depth"), ("image", "depth"), ("images", "depth"), ("images", "depths"))
"""(folder of photos, folder of depth)."""

SPLITS = ("train", "val", "valid", "validation", "test")
"""Names of folders below the photos that are taken for splits."""


def find_layout(folder: Path) -> tuple[Path, Path] | None:
    """Return the folders of photos and of depth in a folder; None where it does not have both."""
    for photos, depth in LAYOUTS:
        if (folder / photos).is_dir() and (folder / depth).is_dir():
            return folder / photos, folder / depth
    return None


def find_pairs(folder: Path, *, split: str, defaults: Facts, allow_missing: bool = False) -> list[Pair]:
    """Find the pairs of a folder, sorted by name.

    ``images/a/0001.jpg`` goes with ``depth/a/0001.png``, or with ``depth/a/0001_depth.png``, which is the name that
    ``zoedepth predict`` gives it; with splits, ``images/train/…`` goes with ``depth/train/…``. A folder without splits
    is the same for every split.

    Args:
        folder: has one of ``LAYOUTS``.
        split: the folder below, where there are splits.
        defaults: domain, unit and camera of all pairs.
        allow_missing: accept photos without depth.

    Raises:
        InputError: the folder has no such layout or split, photos or depths lack their other half, or nobody says the
            unit or the domain.
    """
    layout = find_layout(folder)
    if layout is None:
        wanted = ", ".join(f"{photos}/ and {depth}/" for photos, depth in LAYOUTS)
        raise InputError(f"{folder} has no folders of photos and depth. Name them {wanted}")
    if splits := [name for name in SPLITS if (layout[0] / name).is_dir()]:
        if split not in splits:
            raise InputError(f"{layout[0]} has the splits {splits}, and not {split!r}: choose one of them")
        layout = (layout[0] / split, layout[1] / split)
    if not defaults.domain:
        raise InputError(f'{folder} needs a domain: write {{"domain": "indoor"}} into {folder / DEFAULTS_FILE}')
    photos, depths = _by_stem(layout[0], IMAGE_SUFFIXES), _by_stem(layout[1], frozenset(DEPTH_SUFFIXES))
    for stem in [stem for stem in depths if stem not in photos and stem.endswith("_depth")]:
        depths.setdefault(stem.removesuffix("_depth"), depths.pop(stem))
    _check_matched(layout, photos, depths, allow_missing=allow_missing)
    pairs = [
        Pair(photo, depths.get(stem), "depth", None, defaults.domain, defaults.camera) for stem, photo in photos.items()
    ]
    for pair in pairs:
        check_unit(pair, defaults, str(pair.target))
    return pairs


def _check_matched(
    layout: tuple[Path, Path], photos: dict[str, Path], depths: dict[str, Path], *, allow_missing: bool
) -> None:
    if not photos:
        raise InputError(f"there are no photos in {layout[0]}")
    bare = [] if allow_missing else [path for stem, path in photos.items() if stem not in depths]
    alone = [path for stem, path in depths.items() if stem not in photos]
    if bare or alone:
        counts = [f"{len(bare)} photos without depth, the first is {bare[0]}"] if bare else []
        counts += [f"{len(alone)} depths without photo, the first is {alone[0]}"] if alone else []
        raise InputError(
            f"{layout[0]} and {layout[1]} have {', and '.join(counts)}. Names must agree up to the suffix: rename, add "
            "or remove these files"
        )


def _by_stem(folder: Path, suffixes: frozenset[str]) -> dict[str, Path]:
    """Map path without suffix, relative to the folder, to file; sorted. Hidden files are ignored."""
    found: dict[str, Path] = {}
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if name.startswith(".") or PurePath(name).suffix.lower() not in suffixes:
                continue
            path = Path(parent, name)
            stem = path.relative_to(folder).with_suffix("").as_posix()
            if stem in found:
                raise InputError(f"{path} and {found[stem]} have the same name up to the suffix: remove one of them")
            found[stem] = path
    return dict(sorted(found.items()))
