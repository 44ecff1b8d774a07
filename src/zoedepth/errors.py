"""The exceptions of the package. Each message says what is wrong and what to do."""

from __future__ import annotations


class ZoeDepthError(Exception):
    """Base of every error that is raised on purpose. Catch it to tell such errors from bugs."""


class InputError(ZoeDepthError, ValueError):
    """A file, array or option cannot be used. The message names it and says how to mend it."""


class TrainingError(ZoeDepthError):
    """A training cannot go on. The message says what happened, at which step and with which images."""


class MissingExtraError(ZoeDepthError, ImportError):
    """A feature needs an optional dependency that is not installed.

    Args:
        extra: name of the extra in ``pyproject.toml``, e.g. "demo".
        feature: the thing that the user asked for, as the subject of a sentence, e.g. "zoedepth demo".
    """

    def __init__(self, extra: str, feature: str) -> None:
        super().__init__(f"{feature} needs the extra [{extra}]. Install it: pip install 'zoedepth[{extra}]'")
        self.extra = extra
        self.feature = feature

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        # Between processes, exceptions are rebuilt from ``args`` (the message), but this one takes two arguments.
        return type(self), (self.extra, self.feature)
