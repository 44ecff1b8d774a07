"""The exceptions of the package: one family, each message saying what was wrong and what to do."""

from __future__ import annotations


class ZoeDepthError(Exception):
    """Base of every error raised on purpose; catch it to tell them from bugs."""


class InputError(ZoeDepthError, ValueError):
    """The caller's file, array or option cannot be used; the message names it and says how to mend it."""


class TrainingError(ZoeDepthError):
    """A training cannot go on; the message says what happened, at which step and with which images."""


class MissingExtraError(ZoeDepthError, ImportError):
    """A feature needs an optional dependency that is not installed.

    Args:
        extra: name of the extra in ``pyproject.toml``, e.g. "demo".
        feature: what the user asked for, as the subject of a sentence, e.g. "zoedepth demo".
    """

    def __init__(self, extra: str, feature: str) -> None:
        super().__init__(f"{feature} needs the extra [{extra}]. Install it: pip install 'zoedepth[{extra}]'")
        self.extra = extra
        self.feature = feature

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        # Exceptions are rebuilt from ``args`` (the message) when they cross a process border; this one takes two.
        return type(self), (self.extra, self.feature)
