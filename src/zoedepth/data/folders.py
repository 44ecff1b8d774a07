"""Folders of pairs without a list: photos in one folder, depth in another, matched by their names."""

from pathlib import Path, PurePath

from zoedepth.data.facts import DEFAULTS_FILE, Facts
from zoedepth.data.lists import Pair, check_unit
from zoedepth.data.names import composed
from zoedepth.data.stamps import TOLERANCE, pair_by_time, seconds_of_name
from zoedepth.errors import InputError
from zoedepth.folders import list_files
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.outputs.ownership import is_own_file
from zoedepth.stored import DEPTH_SUFFIXES

LAYOUTS = (("rgb", "depth"), ("image", "depth"), ("images", "depth"), ("images", "depths"))
"""(folder of photos, folder of depth)."""

SPLITS = ("train", "val", "valid", "validation", "test")
"""Names of folders below the photos that are taken for splits."""


class _Half:
    """The files of the photos, or of the depth, by their names.

    Args:
        folder: where they are; see ``zoedepth.folders.list_files`` for what is left out.
        suffixes: suffixes (lower case) of the files that count.

    Raises:
        InputError: two files have one name, or a folder cannot be read.
    """

    def __init__(self, folder: Path, suffixes: frozenset[str]) -> None:
        self.folder = folder
        self.files: dict[str, Path] = {}
        """Path without suffix, relative to the folder → file; sorted."""
        self.others: dict[str, Path] = {}
        """Files of other suffixes, in the same way."""
        listing = list_files(folder)
        for unread, reason in listing.unreadable.items():
            raise InputError(f"{unread} cannot be read: {reason}")
        for path in sorted(listing.files):
            stem = composed(path.relative_to(folder).with_suffix("").as_posix())
            if path.suffix.lower() not in suffixes:
                if path.is_symlink() and not path.exists():  # likely a folder of photos
                    raise InputError(f"{path} is a link that leads nowhere: is its disk there? Else remove the link")
                self.others[stem] = path
                continue
            if (twin := self.files.get(stem)) is not None:
                why = (
                    "the same name up to the suffix"
                    if twin.with_suffix("") == path.with_suffix("")
                    else "names that look the same, with accents stored in different ways (NFC, NFD)"
                )
                raise InputError(f"{path} and {twin} have {why}: remove one of them")
            self.files[stem] = path


def find_layout(folder: Path) -> tuple[Path, Path] | None:
    """Return the folders of photos and of depth in a folder; None where it does not have both.

    Raises:
        InputError: it has more than two of them, so that it is not clear which go together.
    """
    found = [
        (folder / photos, folder / depth)
        for photos, depth in LAYOUTS
        if (folder / photos).is_dir() and (folder / depth).is_dir()
    ]
    if len(found) > 1:
        names = sorted({path.name for layout in found for path in layout})
        raise InputError(
            f"{folder} has the folders {', '.join(names)}: it is not clear which of them go together. Leave one of "
            "photos and one of depth there, or give a list"
        )
    return found[0] if found else None


def find_pairs(
    folder: Path, *, split: str, defaults: Facts, allow_missing: bool = False, keep_missing: bool = False
) -> list[Pair]:
    """Find the pairs of a folder, sorted by name.

    ``images/a/0001.jpg`` goes with ``depth/a/0001.png``, or with ``depth/a/0001_depth.png``, which is the name that
    ``zoedepth predict`` gives it; with splits, ``images/train/…`` goes with ``depth/train/…``. A folder without splits
    is the same for every split. Where the names are times that do not agree, as in TUM RGB-D, a photo goes with the
    depth that is nearest in time (``zoedepth.data.stamps``), and what has no other half is left out.

    Args:
        folder: has one of ``LAYOUTS``.
        split: the folder below, where there are splits.
        defaults: domain, unit and camera of all pairs.
        allow_missing: accept photos without depth.
        keep_missing: give photos and depths without their other half the file that it would be, if they are few.

    Raises:
        InputError: the folder has no such layout or split, photos or depths lack their other half, a name means two
            files, or nobody says the unit or the domain.
    """
    layout = find_layout(folder)
    if layout is None:
        wanted = ", ".join(f"{photos}/ and {depth}/" for photos, depth in LAYOUTS)
        raise InputError(f"{folder} has no folders of photos and depth. Name them {wanted}")
    if splits := [name for name in SPLITS if (layout[0] / name).is_dir()]:
        if split not in splits:
            raise InputError(f"{layout[0]} has the splits {splits}, and not {split!r}: choose one of them")
        _check_split(layout[0], splits)
        layout = (layout[0] / split, layout[1] / split)
    domain = defaults.domain
    if not domain:
        raise InputError(f'{folder} needs a domain: write {{"domain": "indoor"}} into {folder / DEFAULTS_FILE}')
    photos, depths = _Half(layout[0], IMAGE_SUFFIXES), _Half(layout[1], frozenset(DEPTH_SUFFIXES))
    for stem in photos.files.keys() - depths.files.keys():
        if is_own_file(photos.files[stem]):  # written beside the photos by `zoedepth predict`
            del photos.files[stem]
    _drop_endings(photos, depths)
    if photos.files.keys() != depths.files.keys() and _are_times(photos) and _are_times(depths):
        _match_times(photos, depths, allow_missing=allow_missing)
    absent = _other_halves(photos, depths) if keep_missing else set()
    _check_matched(photos, depths, allow_missing=allow_missing)
    pairs = [
        Pair(photo, depths.files.get(stem), "depth", None, domain, defaults.camera, max_depth=defaults.max_depth)
        for stem, photo in photos.files.items()
    ]
    for pair in pairs:
        if absent.isdisjoint(pair.files):
            check_unit(pair, defaults, str(pair.target))
    return pairs


def _other_halves(photos: _Half, depths: _Half) -> set[Path]:
    """Add the files that photos and depths without their other half lack, if most have it; return these files."""
    matched = photos.files.keys() & depths.files.keys()
    absent = set()
    if 2 * len(matched) >= max(len(photos.files), len(depths.files)):
        for half, other in ((photos, depths), (depths, photos)):
            suffix = half.files[min(matched)].suffix
            for stem in other.files.keys() - matched - half.others.keys():
                half.files[stem] = (half.folder / stem).with_name(f"{PurePath(stem).name}{suffix}")
                absent.add(half.files[stem])
            half.files = dict(sorted(half.files.items()))
    return absent


def _check_split(photos: Path, splits: list[str]) -> None:
    """Refuse photos that no split has: they would be left out without a word."""
    for path in sorted(photos.iterdir()):
        if path.name in splits or path.name.startswith("."):
            continue
        if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
            raise InputError(
                f"{photos} has the splits {splits}, and {path.name} in none of them. Move it into one, or elsewhere"
            )


def _drop_endings(photos: _Half, depths: _Half) -> None:
    """Name depth as ``zoedepth predict`` writes it, 0001_depth.png, after its photo, 0001."""
    for stem in [stem for stem in depths.files if stem not in photos.files and stem.endswith("_depth")]:
        plain = stem.removesuffix("_depth")
        if plain in depths.files:
            raise InputError(
                f"{depths.files[plain]} and {depths.files[stem]} may both be the depth of {plain}: remove one of them"
            )
        depths.files[plain] = depths.files.pop(stem)


def _are_times(half: _Half) -> bool:
    return bool(half.files) and all(seconds_of_name(PurePath(stem).name) is not None for stem in half.files)


def _match_times(photos: _Half, depths: _Half, *, allow_missing: bool) -> None:
    """Give each depth map the name of the photo of its time, and leave out what has no other half."""
    found: dict[str, Path] = {}
    folders = {PurePath(stem).parent for stem in photos.files}
    for folder in sorted(folders):  # each may be a recording of its own
        (stems, times), (others, other_times) = (_times(half, folder) for half in (photos, depths))
        found |= {stems[i]: depths.files[others[j]] for i, j in pair_by_time(times, other_times)}
    if not found:
        raise InputError(
            f"the names in {photos.folder} and {depths.folder} are times, and no two are within {TOLERANCE} s of each "
            "other. Write a list of the pairs"
        )
    depths.files = found
    if not allow_missing:
        photos.files = {stem: path for stem, path in photos.files.items() if stem in found}


def _times(half: _Half, folder: PurePath) -> tuple[list[str], list[float]]:
    stems = [stem for stem in half.files if PurePath(stem).parent == folder]
    return stems, [seconds_of_name(PurePath(stem).name) or 0.0 for stem in stems]


def _check_matched(photos: _Half, depths: _Half, *, allow_missing: bool) -> None:
    if not photos.files:
        others = f", but {next(iter(photos.others.values())).name} and others" if photos.others else ""
        raise InputError(
            f"there are no photos in {photos.folder}{others}. Photos are {', '.join(sorted(IMAGE_SUFFIXES))}"
        )
    bare = [stem for stem in photos.files if stem not in depths.files]
    alone = [stem for stem in depths.files if stem not in photos.files]
    for stem in bare:
        if stem in depths.others:
            raise InputError(
                f"{depths.others[stem]} cannot hold the depth of {photos.files[stem]}. It must be one of "
                f"{', '.join(DEPTH_SUFFIXES)}"
            )
    for stem in alone:
        if stem in photos.others:
            raise InputError(
                f"{photos.others[stem]}, the photo of {depths.files[stem]}, is of a format that is not read. Convert "
                "it to PNG or JPEG"
            )
    if allow_missing:
        bare = []
    if bare or alone:
        counts = [f"{len(bare)} photos without depth, the first is {photos.files[bare[0]]}"] if bare else []
        counts += [f"{len(alone)} depths without photo, the first is {depths.files[alone[0]]}"] if alone else []
        raise InputError(
            f"{photos.folder} and {depths.folder} have {', and '.join(counts)}. Names must agree up to the suffix: "
            "rename, add or remove these files"
        )
