"""The file that a name means: one in a list, in whatever way its letters, slashes and folders are written."""

import os
import re
import unicodedata
from pathlib import Path

from zoedepth.errors import InputError

_DRIVE = re.compile(r"[A-Za-z]:[/\\]")


def composed(name: str) -> str:
    """Return a name with each accent composed with its letter (NFC): names that look the same become the same."""
    return name if name.isascii() else unicodedata.normalize("NFC", name)


def other_capitals(path: Path) -> Path | None:
    """Return the file that has a missing file's name in other capital letters, as lists from Windows have them."""
    try:
        others = (other for other in path.parent.iterdir() if other.name != path.name)  # that may be a broken link
        return next((other for other in others if other.name.casefold() == path.name.casefold()), None)
    except (OSError, ValueError):
        return None


class Finder:
    """The files that the names of a list mean.

    Args:
        root: the folder that the names are relative to.
        anywhere: names may lead out of it, which those of a list from elsewhere may not.
        leading_slash: names that begin with a slash may be relative all the same, as in the lists of BTS.
    """

    def __init__(self, root: Path, *, anywhere: bool, leading_slash: bool = False) -> None:
        self.root = root
        self._anywhere = anywhere
        self._leading_slash = leading_slash
        self._entries: dict[Path, dict[str, list[str]]] = {}

    def find(self, name: object, where: str) -> Path:
        """Return the file that a name means. It need not exist.

        Raises:
            InputError: the name leads out of the root, is no path on this system, or means one of several files.
        """
        if not isinstance(name, str):
            raise InputError(f"{where}: {name!r} must be text, the path of a file")
        if "\\" in name and not os.path.exists(self.root / name):  # a name may have one, but on Windows it is a slash
            name = name.replace("\\", "/")
        if os.name != "nt" and _DRIVE.match(name):
            raise InputError(
                f"{where}: {name!r} is a path of a Windows system. Write it relative to the folder of the list (or, "
                "for photos with depth, to another that you name with --root)"
            )
        path = self._rooted(name, where)
        if not self._anywhere and (".." in Path(name).parts or not _is_inside(path, self.root)):
            raise InputError(
                f"{where}: {name!r} must be a path inside the folder of the list, without .. and relative to it. If "
                "this list is your own, give the list itself and not its folder, or name the folder of its files with "
                "--root"
            )
        return path if name.isascii() or os.path.exists(path) else self._look(path, where)

    def _rooted(self, name: str, where: str) -> Path:
        if not (self._leading_slash and name.startswith("/")):
            return self.root / name  # an absolute name goes before the root
        relative, absolute = self.root / name.lstrip("/"), Path(name)
        if not (self._anywhere and os.path.exists(absolute)):
            return relative
        if os.path.exists(relative) and not os.path.samefile(relative, absolute):
            raise InputError(
                f"{where}: {name!r} may be {absolute} or {relative}. Remove the slash, or one of the files"
            )
        return absolute

    def _look(self, path: Path, where: str) -> Path:
        """Return the file whose name looks the same: an accent is stored with its letter (NFC) or after it (NFD)."""
        found = Path(path.anchor)
        for part in path.parts[bool(path.anchor) :]:
            if not part.isascii() and not os.path.exists(found / part):
                same = self._names(found).get(composed(part), [part])
                if len(same) > 1:
                    raise InputError(
                        f"{where}: {found} has {len(same)} names that look like {part!r}, with accents stored in "
                        "different ways (NFC, NFD). Rename or remove the others"
                    )
                part = same[0]
            found /= part
        return found

    def _names(self, folder: Path) -> dict[str, list[str]]:
        if folder not in self._entries:
            self._entries[folder] = {}
            try:
                for name in os.listdir(folder):
                    self._entries[folder].setdefault(composed(name), []).append(name)
            except OSError:  # whoever reads the file says what is wrong
                pass
        return self._entries[folder]


def _is_inside(path: Path, root: Path) -> bool:
    return Path(os.path.abspath(path)).is_relative_to(os.path.abspath(root))
