"""HTTP as uvicorn speaks it, with an end to the patience for clients that neither speak nor listen."""

import asyncio
from collections.abc import Callable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from zoedepth.serve.problems import Problem

IDLE = "zoedepth_idle"
"""Name in the state of the lifespan: seconds of patience, see ``Limits.idle``."""
CLOSE = "close"
"""Name in the state of the lifespan: the function that is called when the server begins to shut down."""


class PatientProtocol(H11Protocol):
    """A connection. One that sends no head, or does not take its answer, is cut off after a while."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        seconds: float = self.app_state.get(IDLE, 10.0)
        # Two timers, for a client that sends more has not taken its answer thereby.
        self._head_timer, self._answer_timer = (_Timer(seconds, lambda: self.transport.abort()) for _ in range(2))

    # uvicorn narrows the argument, too: asyncio says that it is a BaseTransport.
    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Begin: a head must come."""
        super().connection_made(transport)
        self._head_timer.start()

    def data_received(self, data: bytes) -> None:
        """Take bytes. Those of a head alone do not extend the patience."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._head_timer.stop()
        elif not self._head_timer.runs and self.timeout_keep_alive_task is None:
            self._head_timer.start()

    def pause_writing(self) -> None:
        """Notice that the client does not take the answer."""
        self.flow.pause_writing()
        self._answer_timer.start()

    def resume_writing(self) -> None:
        """Notice that it takes the answer again."""
        self.flow.resume_writing()
        self._answer_timer.stop()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._head_timer.stop()
        self._answer_timer.stop()
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """Let the service begin nothing new, as the server shuts down."""
        self.app_state.get(CLOSE, lambda: None)()
        super().shutdown()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, with problem details."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):  # an answer has begun: there is no taking it back
            self.transport.close()
            return
        problem = Problem("malformed-request", msg)
        headers = {**problem.headers, "content-length": str(len(problem.body)), "connection": "close"}
        head = h11.Response(status_code=problem.status, headers=list(headers.items()), reason=b"Bad Request")
        for event in (head, h11.Data(data=problem.body), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()


class _Timer:
    """A function that is called some seconds after ``start``, unless ``stop`` comes before."""

    def __init__(self, seconds: float, function: Callable[[], None]) -> None:
        self._seconds, self._function = seconds, function
        self._handle: asyncio.TimerHandle | None = None

    @property
    def runs(self) -> bool:
        return self._handle is not None

    def start(self) -> None:
        self.stop()
        self._handle = asyncio.get_running_loop().call_later(self._seconds, self._function)

    def stop(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
