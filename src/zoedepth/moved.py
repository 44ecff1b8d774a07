"""Old names of this package's modules, and names of isl-org/ZoeDepth's modules, which is imported as zoedepth, too.

Old names can still be imported, with a warning that says the new name, and go with version 0.2. Names of the original
that its README imports stay; others of its names say where to look.
"""

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

MODULES = {
    "zoedepth.baseline_config": "zoedepth.config.baselines",
    "zoedepth.camera": "zoedepth.geometry.camera",
    "zoedepth.card": "zoedepth.weights.card",
    "zoedepth.convert": "zoedepth.weights.layouts",
    "zoedepth.convert.checkpoint": "zoedepth.weights.checkpoint",
    "zoedepth.data.check": "zoedepth.checking",
    "zoedepth.data.open": "zoedepth.opening",
    "zoedepth.data.readers": "zoedepth.stored",
    "zoedepth.evaluation.calibration": "zoedepth.evaluation.uncertainty",
    "zoedepth.evaluation.published": "zoedepth.evaluation.paper_numbers",
    "zoedepth.export.exported": "zoedepth.weights.exported",
    "zoedepth.head_config": "zoedepth.config.heads",
    "zoedepth.heads": "zoedepth.model.heads",
    "zoedepth.hub": "zoedepth.weights.hub",
    "zoedepth.pretrained": "zoedepth.weights.load",
    "zoedepth.releases": "zoedepth.weights.releases",
}
"""Old name of a module → the new one; it holds for what is inside of a package, too."""

NAMES = {
    ("zoedepth.batch", "Found"): ("zoedepth.photos", "Found"),
    ("zoedepth.batch", "find_photos"): ("zoedepth.photos", "find_photos"),
    ("zoedepth.batch", "share_cores"): ("zoedepth.threads", "share_cores"),
    ("zoedepth.images", "read_depth"): ("zoedepth.stored", "read_depth"),
    ("zoedepth.weights.load", "ZoeDepth"): ("zoedepth.weights.pretrained", "ZoeDepth"),
    ("zoedepth.weights.load", "push_to_hub"): ("zoedepth.weights.save", "push_to_hub"),
    ("zoedepth.weights.load", "save_model"): ("zoedepth.weights.save", "save_model"),
}
"""(Module, old name in it) → (module, name) of today."""


ORIGINAL = ("zoedepth.models.builder", "zoedepth.utils.config", "zoedepth.utils.misc")
"""Modules of the original whose functions ``zoedepth.original`` has."""

_ORIGINALS = ("zoedepth.models", "zoedepth.utils", "zoedepth.trainers")
_ORIGINAL_HOME = "zoedepth.original"


class _Finder(MetaPathFinder, Loader):
    """Finds the old names. It is asked first: in a package that was moved, Python would find files of its own accord,
    and make second modules of them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to import a module under its old name; None where it is none."""
        if fullname in ORIGINAL:
            return ModuleSpec(fullname, self, origin=_ORIGINAL_HOME)
        if any(name.startswith(f"{fullname}.") for name in ORIGINAL):
            return ModuleSpec(fullname, self, is_package=True)
        if any(f"{fullname}.".startswith(f"{name}.") for name in _ORIGINALS):
            raise ModuleNotFoundError(
                f"{fullname} is a module of isl-org/ZoeDepth, which this package replaces: there are "
                f"{', '.join(ORIGINAL)} for programs that import them; for others docs/switching.md says what to use",
                name=fullname,
            )
        return ModuleSpec(fullname, self, origin=new) if (new := _new_name(fullname)) else None

    def exec_module(self, module: ModuleType) -> None:
        """Put the module of today in place of the empty one that was made for the old name."""
        assert module.__spec__ is not None
        if module.__spec__.origin is None:  # a package of the original, with nothing in it but its modules
            return
        old, new = module.__spec__.name, module.__spec__.origin
        sys.modules[old] = importlib.import_module(new)
        if new != _ORIGINAL_HOME:
            _warn(old, new, stacklevel=3)  # the importing line: warnings do not count importlib's own frames


def moved_name(module: str, name: str) -> object:
    """Return what a name was once in a module, with a warning: for ``__getattr__`` of modules.

    Raises:
        AttributeError: there was no such name.
    """
    if (module, name) not in NAMES:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    home, today = NAMES[module, name]
    _warn(f"{module}.{name}", f"{home}.{today}", stacklevel=4)
    return getattr(importlib.import_module(home), today)


def install() -> None:
    """Let Python find modules by their old names."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


def _new_name(name: str) -> str | None:
    above, inside = name, ""
    while above:
        if above in MODULES:
            return MODULES[above] + inside
        above, _, last = above.rpartition(".")
        inside = f".{last}{inside}"
    return None


def _warn(old: str, new: str, *, stacklevel: int) -> None:
    warnings.warn(f"{old} is now {new}: the old name goes with version 0.2", DeprecationWarning, stacklevel=stacklevel)
