"""The provenance of weights: their licence, the data they were trained on, and what was measured with them.

Every file of weights carries it, and every command hands it on: whoever converts, fine-tunes, exports or publishes a
model passes on its terms.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from zoedepth.errors import InputError
from zoedepth.stored import parse_json

_NONCOMMERCIAL = re.compile(r"non-?\s?commercial|\bnc\b|\bresearch\b|academic", re.IGNORECASE)
MAX_TEXT = 10_000
"""Letters of a licence or a description, at most: they may come from anyone's file."""


@dataclass(frozen=True)
class Provenance:
    """Licence, training data and measured numbers of weights; None and nothing where they are not known."""

    licence: str | None = None
    """Licence of the weights: an identifier of the Hub such as "cc-by-nc-4.0", or any text."""
    trained_on: str | None = None
    """Training data, with its terms."""
    measured: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Name of a data set → name of a metric, see ``metrics.Metrics`` → its value."""

    def with_licence(self, licence: str | None) -> "Provenance":
        """Return the provenance with a licence that the caller names; None keeps the one there is.

        Raises:
            InputError: the weights are for non-commercial use, and the licence would drop that.
        """
        if licence is None or not licence.strip() or licence.strip().lower() == "unknown":
            return self
        if self.licence and _NONCOMMERCIAL.search(self.licence) and not _NONCOMMERCIAL.search(licence):
            raise InputError(
                f"licence {licence!r} is not possible: these weights come under {self.licence!r}, and weights made of "
                "them stay non-commercial. Leave the licence out, or name one that is non-commercial too"
            )
        return replace(self, licence=licence)

    def after_training(self, data: Mapping[str, str | None]) -> "Provenance":
        """Return the provenance of weights that were trained further. Nothing is measured with them yet.

        Weights carry the terms of their data: where some of it is for non-commercial use, so are they.

        Args:
            data: description of a data set → its licence, None where nobody says it.
        """
        described = ", ".join(name if licence is None else f"{name}: {licence}" for name, licence in data.items())
        before = f"; before that: {self.trained_on}" if self.trained_on else ""
        binding = [licence for licence in data.values() if licence and _NONCOMMERCIAL.search(licence)]
        licence = self.licence
        if binding and not (licence and _NONCOMMERCIAL.search(licence)):
            licence = f"non-commercial, as the training data: {', '.join(dict.fromkeys(binding))}"
        return Provenance(licence, f"{described}{before}"[:MAX_TEXT])

    def to_texts(self) -> dict[str, str]:
        """Return texts for the header of a file; what is not known is left out."""
        texts = {"licence": self.licence, "trained_on": self.trained_on}
        known = {name: text for name, text in texts.items() if text}
        measured = {
            name: {metric: value for metric, value in metrics.items() if math.isfinite(value)}
            for name, metrics in self.measured.items()
        }
        return known | ({"measured": json.dumps(measured)} if measured else {})


def from_texts(texts: Mapping[str, str]) -> Provenance:
    """Return the provenance in the header of a file, where other texts may stand too.

    Raises:
        InputError: the measured numbers are none.
    """
    licence, trained_on = (" ".join(texts.get(name, "").split())[:MAX_TEXT] for name in ("licence", "trained_on"))
    measured = parse_json(texts["measured"], "the measured numbers in its metadata") if "measured" in texts else {}
    for metrics in measured.values():
        if not isinstance(metrics, dict) or not all(_is_number(value) for value in metrics.values()):
            raise InputError("the measured numbers in its metadata are no table of numbers: save the model again")
    return Provenance(licence or None, trained_on or None, measured)


def from_card(text: str) -> Provenance:
    """Return the licence in the front matter of a model card, a README.md."""
    front = re.match(r"---\s*\n(.*?)\n---", text[:MAX_TEXT], re.DOTALL)
    entries = re.findall(r"^(license|license_name):[ \t]*(.*)$", front[1], re.MULTILINE) if front else []
    found = {name: value.strip().strip("\"'") for name, value in entries}
    licence = found.get("license", "")
    if licence == "other":
        licence = found.get("license_name", licence)
    return Provenance(licence if licence not in ("", "unknown") else None)


def require_licence(provenance: Provenance) -> None:
    """Refuse weights whose licence nobody says, before they are published.

    Raises:
        InputError: the licence is not known.
    """
    if provenance.licence is None:
        raise InputError(
            "the licence of these weights is not known, and without one nobody may use them: give one (--licence mit, "
            "cc-by-nc-4.0 ...). Weights carry the terms of the data they were trained on"
        )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
