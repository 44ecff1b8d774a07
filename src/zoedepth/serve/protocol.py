"""HTTP as uvicorn speaks it, with an end to the patience for clients that neither speak nor listen."""

import asyncio
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
        self._patience: asyncio.TimerHandle | None = None
        self._seconds: float = self.app_state.get(IDLE, 10.0)

    # uvicorn narrows the argument, too: asyncio says that it is a BaseTransport.
    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Begin: a head must come."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Take bytes. Those of a head alone do not extend the patience."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._stop_waiting()
        elif self._patience is None and self.timeout_keep_alive_task is None:
            self._wait()

    def pause_writing(self) -> None:
        """Notice that the client does not take the answer."""
        self.flow.pause_writing()
        self._wait()

    def resume_writing(self) -> None:
        """Notice that it takes the answer again."""
        self.flow.resume_writing()
        self._stop_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._stop_waiting()
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

    def _wait(self) -> None:
        self._stop_waiting()
        self._patience = self.loop.call_later(self._seconds, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None
