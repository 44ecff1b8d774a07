"""The files of scores in a folder: one for each process, whose first line says which question they answer."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

from zoedepth.errors import InputError
from zoedepth.evaluation.identity import Stamps
from zoedepth.evaluation.scoring import Score
from zoedepth.images import atomic_path

PATTERN = "scores-*-of-*.jsonl"
"""The names of the files."""


class ScoreFiles:
    """The scores of one source on one data set, in the files of a folder.

    Args:
        folder: where they are; made when something is written.
        header: the first line of each file: the question that the scores answer.
        stamps: says for each score whether it still holds.

    Raises:
        InputError: a file of this name holds the scores of something else, or is no file of scores.
    """

    def __init__(self, folder: Path, header: Mapping[str, object], stamps: Stamps) -> None:
        self.folder = folder
        self.stamps = stamps
        self.n_stale = 0
        """Number of scores that ``read`` found and that no longer hold."""
        self._header = json.dumps(header)
        self._file: TextIO | None = None
        for path in self._paths():
            self._check(path)

    def read(self) -> dict[int, Score]:
        """Read the scores that still hold, by the number of their image. A half-written line is left out."""
        found, old = {}, set()
        for path in self._paths():
            for line in _lines(path)[1:]:
                if (record := self._parse(line)) is None:
                    continue
                index, score = record
                if self._holds(line, index, score):
                    found[index] = score
                elif self.stamps.of_data(index):
                    old.add(index)
        self.n_stale = len(old - found.keys())
        return dict(sorted(found.items()))

    def open(self, rank: int, count: int) -> None:
        """Open the file of this process to add to it, without the scores that no longer hold.

        A process that is alone removes those from the files of others, too.
        """
        own = self.folder / f"scores-{rank}-of-{count}.jsonl"
        self.folder.mkdir(parents=True, exist_ok=True)
        for path in {own, *(self._paths() if count == 1 else ())}:
            self._tidy(path)
        self._file = own.open("a", encoding="utf-8", newline="\n")

    def add(self, index: int, score: Score, data: str) -> None:
        """Write the score of an image at once; ``data`` is what ``Stamps.of_data`` said before it was read."""
        assert self._file is not None, "open the files first"
        stamp = self.stamps.of(index, score.name, data=data)
        self._file.write(json.dumps({"index": index, "stamp": stamp, **score.to_json()}) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file of this process."""
        if self._file is not None:
            self._file.close()

    def _paths(self) -> list[Path]:
        return sorted(self.folder.glob(PATTERN))

    def _check(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"{path} is no file of scores: give another --out, or move it")
        first, *rest = _lines(path)
        found = _parse(first)
        if not rest and (found is None and self._begins(first)):
            return  # another process has just begun this file, or was killed then
        if found is None or not isinstance(found.get("about"), dict):
            raise InputError(f"{path} is no file of scores that an evaluation wrote: give another --out, or move it")
        if found != json.loads(self._header):
            raise InputError(
                f"{path} holds the scores of another command: {_difference(found, json.loads(self._header))}. "
                f"Give another --out, or remove {self.folder}"
            )

    def _begins(self, text: str) -> bool:
        """Return True for the beginning of a first line, or nothing."""
        start = '{"about": {'
        return text.startswith(start) or start.startswith(text)

    def _tidy(self, path: Path) -> None:
        """Rewrite a file if it has anything but its header and scores that hold."""
        lines = _lines(path) if path.exists() else [""]
        kept = [line for line in lines[1:] if (r := self._parse(line)) is not None and self._holds(line, *r)]
        text = "\n".join([self._header, *kept, ""])
        if not path.exists() or path.read_bytes() != text.encode():
            with atomic_path(path) as part:
                part.write_text(text, encoding="utf-8", newline="\n")

    def _parse(self, line: str) -> tuple[int, Score] | None:
        """Return the image and score of a line; None for one that is not whole."""
        record = _parse(line)
        try:
            return None if record is None else (int(record["index"]), Score.from_json(record))
        except (KeyError, TypeError, ValueError):
            return None

    def _holds(self, line: str, index: int, score: Score) -> bool:
        record = _parse(line) or {}
        return record.get("stamp") == self.stamps.of(index, score.name)


def _lines(path: Path) -> list[str]:
    """Return the lines of a file; bytes that are no text become marks, so that only their own line is lost."""
    return path.read_text(encoding="utf-8", errors="replace").strip("\0").split("\n")


def _parse(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Say what differs between two headers."""
    old, new = ({**values.get("about", {}), "protocols": values.get("protocols")} for values in (there, here))
    names = sorted(name for name in {*old, *new} if old.get(name) != new.get(name))
    return ", ".join(f"{name} was {old.get(name)!r} and is {new.get(name)!r}" for name in names)
