"""Who may ask, and how much may be sent: checked from the head of a request, before anything of its body is read.

An ASGI middleware around everything else, in the order: shutting down, Host, Origin, token, length of the body. It also
puts the headers that keep browsers out of trouble on every answer.
"""

import asyncio
import hmac
import ipaddress
import time
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from typing import Any

from zoedepth.serve.metrics import Metrics
from zoedepth.serve.problems import ClientGone, Problem
from zoedepth.serve.settings import Settings

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

PAGE_POLICY = "; ".join([
    "default-src 'none'",
    "script-src 'self'",
    "style-src 'self'",
    "img-src 'self' blob: data:",
    "media-src 'self' blob:",
    "font-src 'self'",
    "connect-src 'self' blob: data:",
    "worker-src 'self' blob:",
    "manifest-src 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
])  # fmt: skip
"""Things that the page may load: its own files, and pictures and meshes that it made itself."""

HEADERS = {
    "content-security-policy": PAGE_POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(self), xr-spatial-tracking=(self), fullscreen=(self), geolocation=(), microphone=()",
}
"""Headers of every answer."""

OPEN_PATHS = ("/healthz", "/readyz")
"""Paths that answer whatever name they are called by, and need no token: a container's own checks."""

BEGAN = "zoedepth.began"
"""Name in the scope of a request: when its head came, by ``time.perf_counter``."""

_SECRET_PATHS = ("/v1/", "/metrics")
_PIECE = 1 << 18  # bytes of an answer that are sent at once, so that a stalled reader is noticed
_DISCARDED, _LINGER = 900_000, 2.0  # bytes and seconds of an unread body, after the answer
_FREE_SECONDS = 10.0


class Guard:
    """The middleware.

    Args:
        app: the application that is guarded.
        settings: the settings of the service.
        metrics: where requests are counted.
        admit: function that raises a ``Problem`` for a photo for which there is no room, whatever it is.
        on_close: function that is called when the service begins to shut down.
    """

    def __init__(
        self,
        app: Application,
        settings: Settings,
        metrics: Metrics,
        *,
        admit: Callable[[], None] = lambda: None,
        on_close: Callable[[], None] = lambda: None,
    ) -> None:
        self._app = app
        self._settings = settings
        self._metrics = metrics
        self._n_uploads = 0
        self._held = 0
        self._admit, self._on_close = admit, on_close
        self.closing = asyncio.Event()
        """Set when the service begins to shut down."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or hand it on."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":  # no web sockets here
            return await send({"type": "websocket.close", "code": 1008})
        started = time.perf_counter()
        exchange = _Exchange(scope, receive, send, self)
        scope[BEGAN] = started
        try:
            self._check(scope, exchange)
            exchange.begin()
            await self._app(scope, exchange.receive, exchange.send)
        except Problem as problem:
            await exchange.refuse(problem)
        except ClientGone:
            pass
        finally:
            exchange.end()
            self._metrics.answered(scope, exchange.status, time.perf_counter() - started)

    def close(self) -> None:
        """Begin nothing new: refuse what comes, and what waits. What is computed is finished."""
        if not self.closing.is_set():
            self.closing.set()
            self._on_close()

    def _check(self, scope: Scope, exchange: "_Exchange") -> None:
        """Raise the ``Problem`` for which the head of a request is refused."""
        headers = exchange.headers
        path = scope["path"]
        if path in OPEN_PATHS:
            return
        if self.closing.is_set():
            raise Problem("shutting-down", "The service is shutting down and begins nothing new. Try again later.")
        host = _host(headers.get("host", ""))
        if not host_is_known(host, self._settings.hosts):
            raise Problem(
                "other-host",
                f"The service does not go by the name {host[:100]!r}. Whoever runs it can allow that: --allow-host.",
            )
        self._check_origin(headers)
        preflight = scope["method"] == "OPTIONS" and "access-control-request-method" in headers
        if self._settings.token is not None and path.startswith(_SECRET_PATHS) and not preflight:
            _check_token(headers.get("authorization", ""), self._settings.token)
        limit = self._settings.limits.max_body
        if exchange.length is not None and exchange.length > limit:
            raise too_large(limit)
        if scope["method"] == "POST" and path.startswith("/v1/"):
            self._admit()

    def _check_origin(self, headers: dict[str, str]) -> None:
        origin = headers.get("origin")
        if origin is None:
            # Pictures and scripts of other pages bring no Origin, but browsers say where they come from.
            if headers.get("sec-fetch-site") in ("cross-site", "same-site") and (
                headers.get("sec-fetch-mode") != "navigate"
            ):
                raise Problem("other-origin", "This was asked by a page of another site.")
            return
        _, _, site = origin.partition("://")
        if site != headers.get("host") and origin not in self._settings.origins:
            raise Problem(
                "other-origin",
                f"A page of {origin[:100]!r} may not use this service. Whoever runs it can allow that: --allow-origin.",
            )

    def add_upload(self) -> None:
        """Count a body that begins to come in.

        Raises:
            Problem: there are too many.
        """
        if self._n_uploads >= self._settings.limits.max_uploads:
            raise Problem("busy", f"{self._n_uploads} other photos are being sent already. Try again in a moment.")
        self._n_uploads += 1

    def end_upload(self) -> None:
        """Count a body as received."""
        self._n_uploads -= 1

    def hold(self, n_bytes: int) -> None:
        """Count bytes of bodies that are held in memory; fewer by a negative number.

        Raises:
            Problem: there are too many.
        """
        if n_bytes > 0 and self._held + n_bytes > self._settings.limits.max_held:
            raise Problem("busy", "The photos of other requests fill the memory. Try again in a moment.")
        self._held += n_bytes

    @property
    def settings(self) -> Settings:
        """The settings of the service."""
        return self._settings


class _Exchange:
    """One request and its answer: what came in is counted, and the answer gets its headers."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, guard: Guard) -> None:
        self._receive, self._send, self._guard = receive, send, guard
        self.headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        self.length = _length(self.headers)
        self._unread = bool(self.length) or "transfer-encoding" in self.headers
        self._uploads = False
        self._n_read = 0
        self._began = time.monotonic()
        self.status = 0
        """Status of the answer; 0 where there was none."""

    def begin(self) -> None:
        """Count the body that comes."""
        if self._unread:
            self._guard.add_upload()
            self._uploads = True

    def end(self) -> None:
        """Forget what was counted."""
        if self._uploads:
            self._guard.end_upload()
        self._uploads = False
        self._guard.hold(-self._n_read)
        self._n_read = 0

    async def receive(self) -> Message:
        """Return the next piece of the body, within the limits; after its end, wait for the client to hang up."""
        if not self._unread:
            return await self._receive()
        message = await self._in_time()
        if message["type"] == "http.request":
            piece = len(message.get("body", b""))
            if self._n_read + piece > self._guard.settings.limits.max_body:
                raise too_large(self._guard.settings.limits.max_body)
            self._guard.hold(piece)
            self._n_read += piece
            self._unread = message.get("more_body", False)
            if not self._unread:
                self._guard.end_upload()
                self._uploads = False
        return message

    async def _in_time(self) -> Message:
        """Return the next message of a body; refuse one that comes too slowly, or while the service shuts down."""
        limits = self._guard.settings.limits
        allowed = min(_FREE_SECONDS + self._n_read / limits.slowest, limits.max_seconds)
        coming = asyncio.ensure_future(self._receive())
        closing = asyncio.ensure_future(self._guard.closing.wait())
        try:
            await asyncio.wait(
                {coming, closing},
                timeout=max(0.0, self._began + allowed - time.monotonic()),
                return_when=asyncio.FIRST_COMPLETED,
            )
            if coming.done():
                return coming.result()
            if closing.done():
                raise Problem("shutting-down", "The service is shutting down. Try again later.")
            raise Problem(
                "slow-body", f"Only {self._n_read:,} bytes of the body came in {allowed:.0f} seconds. Try again."
            )
        finally:
            closing.cancel()
            coming.cancel()

    async def send(self, message: Message) -> None:
        """Send a part of the answer, with the headers of the house, in pieces."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            given = {name.lower() for name, _ in message["headers"]}
            further = {name: value for name, value in HEADERS.items() if name.encode() not in given}
            if self._unread:
                further["connection"] = "close"
            origin = self.headers.get("origin")
            if origin in self._guard.settings.origins and b"access-control-allow-origin" not in given:
                further |= {"access-control-allow-origin": origin, "vary": "origin"}  # for refusals, too
            message["headers"] = [
                *message["headers"],
                *((name.encode(), value.encode()) for name, value in further.items()),
            ]
            return await self._send(message)
        body, more = message.get("body", b""), message.get("more_body", False)
        for start in range(0, len(body), _PIECE):
            await self._send({
                "type": "http.response.body", "body": body[start : start + _PIECE], "more_body": True,
            })  # fmt: skip
        if more:
            return None
        if self._unread:
            await self._discard()
        return await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def refuse(self, problem: Problem) -> None:
        """Send the answer that tells of a problem, if none has begun."""
        if self.status:
            return
        headers = {**problem.headers, "content-length": str(len(problem.body))}
        await self.send({
            "type": "http.response.start",
            "status": problem.status,
            "headers": [(name.encode(), value.encode("latin-1", "replace")) for name, value in headers.items()],
        })  # fmt: skip
        await self.send({"type": "http.response.body", "body": problem.body})

    async def _discard(self) -> None:
        """Let a client that is still sending read its answer: closing at once would tear it from its hands."""
        if self.headers.get("expect", "").lower() == "100-continue" and self._n_read == 0:
            return  # it waits for our word, and has the answer now
        n_bytes, until = 0, time.monotonic() + _LINGER
        with suppress(asyncio.TimeoutError):
            while self._unread and n_bytes < _DISCARDED:
                message = await asyncio.wait_for(self._receive(), max(0.0, until - time.monotonic()))
                n_bytes += len(message.get("body", b""))
                self._unread = message["type"] == "http.request" and message.get("more_body", False)


def too_large(limit: int) -> Problem:
    """Return the problem of a body beyond the limit in bytes."""
    return Problem("body-too-large", f"The body has more than {limit:,} bytes. Send the photo resized or as a JPEG.")


def host_is_known(host: str, names: tuple[str, ...]) -> bool:
    """Return True if the service may be called by this name (lower case, without port).

    A page of another site can only reach a local service by a name of its own that it points here (DNS rebinding).
    Addresses in numbers are no names, and localhost is nobody's.
    """
    if host == "localhost" or host.endswith(".localhost") or host in (name.lower() for name in names):
        return True
    with suppress(ValueError):
        ipaddress.ip_address(host.strip("[]"))
        return True
    return False


def _host(value: str) -> str:
    """Return the name in a Host header, in lower case and without the port."""
    value = value.lower()
    return value.partition("]")[0] + "]" if value.startswith("[") else value.partition(":")[0]


def _check_token(authorization: str, token: str) -> None:
    scheme, _, given = authorization.partition(" ")
    if scheme.lower() != "bearer" or not hmac.compare_digest(
        given.strip().encode("latin-1", "replace"), token.encode()
    ):
        raise Problem(
            "token-needed",
            "This service asks for a token. Send it as the header Authorization: Bearer TOKEN.",
            headers={"www-authenticate": 'Bearer realm="zoedepth"'},
        )


def _length(headers: dict[str, str]) -> int | None:
    """Return the length of the body as its header says it; None where it does not. The server has checked the form."""
    value = headers.get("content-length", "")
    return int(value) if value.isdecimal() else None
