"""Everything that whoever runs the service can choose, with its defaults."""

import math
import re
from dataclasses import dataclass, field, fields
from typing import Literal

from zoedepth.errors import InputError

_HOST = re.compile(r"[A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]")
_ORIGIN = re.compile(r"https?://[A-Za-z0-9.\[\]:-]+")
_SHORTEST_TOKEN = 16


@dataclass(frozen=True)
class Limits:
    """Limits to what one client, or all of them together, can ask of the service.

    Raises:
        InputError: one of them is not above 0.
    """

    max_body: int = 50_000_000
    """Bytes of the body of a request."""
    max_pixels: int = 50_000_000
    """Pixels of a photo, by its header: larger ones are refused before they are decoded."""
    queue: int = 64
    """Requests that wait for their turn, beside those that are computed. One more gets 429."""
    max_wait: float = 30.0
    """Seconds that a request waits for its turn before it gets 503."""
    max_seconds: float = 60.0
    """Seconds that a request takes in all before it gets 503."""
    max_uploads: int = 256
    """Requests whose bodies are being received at the same time. One more gets 429."""
    max_held: int = 1_000_000_000
    """Bytes of all bodies together that are held in memory. Beyond, requests get 429."""
    slowest: int = 2_000
    """Bytes a second that a body must come with, after its first ten seconds. Slower ones get 408."""
    idle: float = 10.0
    """Seconds that a connection may take to send the head of a request, and to take the next piece of an answer."""
    grace: float = 15.0
    """Seconds that requests have to end after SIGTERM; the process ends within 5 more."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not (value > 0 or (each.name == "queue" and value == 0)) or not math.isfinite(value):
                raise InputError(f"the limit {each.name} must be above 0, got {value}")


@dataclass(frozen=True)
class Settings:
    """Models, devices, clients and limits of the service.

    Raises:
        InputError: a value that makes no sense.
    """

    models: tuple[str, ...] = ("zoed-lite",)
    """Models as ``load_model`` takes them; clients choose among these by name, and the first is the default."""
    device: str = "auto"
    """Device of all models, see ``Predictor``."""
    precision: Literal["float32", "bfloat16", "float16"] = "float32"
    """Number type that the models compute in, see ``Predictor``."""
    threads: int | None = None
    """Photos that are computed at the same time; None: a core for each on the CPU."""
    batch_size: int | None = None
    """Photos that go through a model together; None: 8 on an accelerator, 1 on the CPU, where more are no faster."""
    batch_wait: float = 0.005
    """Seconds that a photo waits for others of its size."""
    token: str | None = field(default=None, repr=False)
    """Secret that every request to /v1 and /metrics must bring (Authorization: Bearer); None: none is asked for."""
    hosts: tuple[str, ...] = ()
    """Names, beside localhost and all addresses in numbers, by which the service may be called."""
    origins: tuple[str, ...] = ()
    """Sites whose pages may call the service (CORS), e.g. https://example.org."""
    limits: Limits = field(default_factory=Limits)
    """Limits of every request."""

    def __post_init__(self) -> None:
        if not self.models:
            raise InputError("give at least one model (--model)")
        for name, value in (("threads", self.threads), ("batch_size", self.batch_size)):
            if value is not None and value < 1:
                raise InputError(f"{name} must be 1 or more, got {value}")
        if self.token is not None and (len(self.token) < _SHORTEST_TOKEN or not self.token.isascii()):
            raise InputError(
                f"the token must have at least {_SHORTEST_TOKEN} letters, digits and signs of ASCII: make one with "
                "python -c 'import secrets; print(secrets.token_urlsafe())'"
            )
        for host in self.hosts:
            if not _HOST.fullmatch(host):
                raise InputError(f"{host!r} is no name of a host: give it without port and slashes (--allow-host)")
        for origin in self.origins:
            if not _ORIGIN.fullmatch(origin):
                raise InputError(f"{origin!r} is no origin: give it as https://example.org (--allow-origin)")
