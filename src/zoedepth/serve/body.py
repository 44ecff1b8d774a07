"""The body of a request: a photo by itself, or a form with several parts. It is held in memory and nowhere else."""

from collections.abc import Collection
from dataclasses import dataclass, field

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect, Request

from zoedepth.serve.problems import ClientGone, Problem

PHOTO = "photo"
"""Name of the part that is the photo."""

_MAX_HEADER = 8_192  # bytes of the headers of a part
_MAX_FIELD = 1 << 20  # bytes of a part that is no photo
_RAW = ("image/", "application/octet-stream")
_HOW = "Send the photo by itself as image/jpeg (or what it is), or as the part photo of multipart/form-data"
_CURL = "With curl that is -H 'Content-Type: image/jpeg' beside --data-binary, or -F photo=@FILE in place of it"


@dataclass
class _Part:
    """A part of a form, as far as it has come."""

    name: str = ""
    header: bytes = b""
    value: bytes = b""
    n_header: int = 0
    content: bytearray = field(default_factory=bytearray)


async def read_parts(request: Request, allowed: Collection[str]) -> dict[str, bytes]:
    """Read the whole body; returns its parts by their names, which are among ``allowed``. File names are ignored.

    Args:
        request: a request whose body nobody has read.
        allowed: names of the parts that may be there; a body that is no form is the part ``PHOTO``.

    Raises:
        Problem: the body is of another type, malformed, or has a part twice, one that is not allowed, or no photo.
        ClientGone: the client hung up.
    """
    kind = request.headers.get("content-type", "application/octet-stream").strip()
    try:
        if kind.lower().startswith("multipart/form-data"):
            parts = await _read_form(request, kind, allowed)
        elif kind.lower().startswith(_RAW):
            parts = {PHOTO: await _read_raw(request)}
        else:
            raise Problem("unsupported-format", f"The body is said to be {kind[:100]!r}. {_HOW}. {_CURL}.")
    except ClientDisconnect as gone:
        raise ClientGone from gone
    if not parts.get(PHOTO):
        raise Problem("invalid-request", f"There is no photo in the body, or it is empty. {_HOW}.")
    return parts


async def _read_raw(request: Request) -> bytes:
    pieces = [piece async for piece in request.stream()]
    return b"".join(pieces)


async def _read_form(request: Request, kind: str, allowed: Collection[str]) -> dict[str, bytes]:
    _, options = parse_options_header(kind)
    boundary = options.get(b"boundary")
    if not boundary:
        raise Problem("malformed-body", "The header Content-Type of the form lacks the boundary of its parts.")
    form = _Form(allowed)
    try:
        # The library's type wants all of its callbacks; it calls those that there are.
        parser = MultipartParser(boundary, form.callbacks)  # pyright: ignore[reportArgumentType]
        async for piece in request.stream():
            parser.write(piece)
        parser.finalize()
    except FormParserError as error:
        raise Problem("malformed-body", f"The form cannot be read: {error}.") from error
    if not form.ended:
        raise Problem("malformed-body", "The form is cut short: the boundary at its end is missing.")
    return {name: bytes(content) for name, content in form.parts.items()}


class _Form:
    """The parts of a form, put together from what the parser calls out."""

    def __init__(self, allowed: Collection[str]) -> None:
        self._allowed = allowed
        self._part = _Part()
        self.parts: dict[str, bytearray] = {}
        """Name → content of the parts that have begun."""
        self.ended = False
        """True after the last boundary."""
        self.callbacks = {
            "on_part_begin": self._begin,
            "on_header_field": self._header,
            "on_header_value": self._value,
            "on_header_end": self._end_header,
            "on_headers_finished": self._name,
            "on_part_data": self._data,
            "on_end": self._end,
        }
        """Functions for the parser of python-multipart, by its names."""

    def _begin(self) -> None:
        self._part = _Part()

    def _header(self, data: bytes, start: int, end: int) -> None:
        self._part.header += data[start:end]
        self._count(end - start)

    def _value(self, data: bytes, start: int, end: int) -> None:
        self._part.value += data[start:end]
        self._count(end - start)

    def _count(self, n_bytes: int) -> None:
        self._part.n_header += n_bytes
        if self._part.n_header > _MAX_HEADER:
            raise Problem("malformed-body", f"The headers of a part have more than {_MAX_HEADER:,} bytes.")

    def _end_header(self) -> None:
        part = self._part
        if part.header.lower() == b"content-disposition":
            _, options = parse_options_header(part.value)
            part.name = options.get(b"name", b"").decode(errors="replace")
        part.header = part.value = b""

    def _name(self) -> None:
        name = self._part.name
        if name not in self._allowed:
            raise Problem(
                "invalid-request", f"The form has a part {name[:100]!r}. Its parts may be {', '.join(self._allowed)}."
            )
        if name in self.parts:
            raise Problem("invalid-request", f"The form has the part {name} twice. Send one request for each photo.")
        self.parts[name] = self._part.content

    def _data(self, data: bytes, start: int, end: int) -> None:
        content = self._part.content
        content += memoryview(data)[start:end]
        if self._part.name != PHOTO and len(content) > _MAX_FIELD:
            raise Problem("invalid-request", f"The part {self._part.name} has more than {_MAX_FIELD:,} bytes.")

    def _end(self) -> None:
        self.ended = True
