"""Errors as the service tells them: problem details by RFC 9457, with a type that programs can rely on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

PREFIX = "urn:zoedepth:problem:"
MEDIA_TYPE = "application/problem+json"
GONE = 499
"""Status by which requests are counted whose clients hung up. Nobody is told it."""


@dataclass(frozen=True)
class Kind:
    """A kind of error: its status, and a title that is always the same."""

    status: int
    """Status code of HTTP."""
    title: str
    """A few words that say what is wrong."""
    retry_after: int | None = None
    """Seconds after which trying again makes sense; None: the same request will always fail."""


KINDS = {
    "malformed-body": Kind(400, "The body of the request is malformed"),
    "malformed-request": Kind(400, "The request is no valid HTTP"),
    "token-needed": Kind(401, "A token is needed"),
    "other-origin": Kind(403, "Pages of other sites may not use this service"),
    "not-found": Kind(404, "There is nothing at this address"),
    "wrong-method": Kind(405, "This address does not take this method"),
    "not-acceptable": Kind(406, "The answer cannot be given in this format"),
    "slow-body": Kind(408, "The body of the request came too slowly"),
    "body-too-large": Kind(413, "The body of the request is too large"),
    "too-many-pixels": Kind(413, "The photo has too many pixels"),
    "unsupported-format": Kind(415, "The body is no photo in a format that is taken"),
    "other-host": Kind(421, "The service does not go by this name"),
    "invalid-request": Kind(422, "The request asks for something that does not exist or cannot be"),
    "unreadable-photo": Kind(422, "The photo cannot be read"),
    "several-frames": Kind(422, "The file has several frames or pages"),
    "busy": Kind(429, "Too many requests wait already", retry_after=2),
    "panorama": Kind(422, "The photo is a panorama of everything around"),
    "internal-error": Kind(500, "There is a fault in the service"),
    "waited-too-long": Kind(503, "The request waited too long for its turn", retry_after=10),
    "took-too-long": Kind(503, "The request took too long", retry_after=30),
    "no-room": Kind(503, "The memory of the service is full", retry_after=10),
    "shutting-down": Kind(503, "The service is shutting down", retry_after=5),
}
"""The last part of the type → the kind."""


class Problem(Exception):
    """An error that a client is told.

    Args:
        kind: a key of ``KINDS``.
        detail: a sentence about this very case: what is wrong, and what to do.
        headers: further headers of the answer.
    """

    def __init__(self, kind: str, detail: str, *, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail
        self.further = dict(headers or {})

    @property
    def status(self) -> int:
        """Status code of HTTP."""
        return KINDS[self.kind].status

    @property
    def headers(self) -> dict[str, str]:
        """Headers of the answer, by lower-case names."""
        wait = KINDS[self.kind].retry_after
        again = {} if wait is None else {"retry-after": str(wait)}
        return {"content-type": MEDIA_TYPE, "cache-control": "no-store", **again, **self.further}

    @property
    def values(self) -> dict[str, str | int]:
        """Members of the problem details."""
        known = KINDS[self.kind]
        return {"type": PREFIX + self.kind, "title": known.title, "status": known.status, "detail": self.detail}

    @property
    def body(self) -> bytes:
        """Body of the answer: JSON in UTF-8."""
        return json.dumps(self.values, ensure_ascii=False).encode(errors="replace")


def sentence(error: Exception) -> str:
    """Return the words of an error as a sentence: those of the package begin small, to stand behind a name."""
    return f"{str(error)[:1].upper()}{str(error)[1:]}"


class ClientGone(Exception):
    """The client hung up, so that nobody waits for the answer."""
