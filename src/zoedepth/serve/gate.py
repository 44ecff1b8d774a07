"""Whose turn it is: some requests are computed at a time, more wait in a queue that ends, and the rest is sent away."""

import asyncio
from collections import deque
from collections.abc import Callable

from zoedepth.serve.problems import Problem


class Gate:
    """Places for requests that are computed, and a queue before them. It belongs to one event loop.

    Args:
        places: requests that are computed at the same time.
        queue: requests that wait, at most.
        watch: function that is told how many wait and how many are computed whenever that changes.
    """

    def __init__(
        self, places: int, queue: int, watch: Callable[[int, int], None] = lambda waiting, inside: None
    ) -> None:
        self._places, self._max_queue, self._watch = places, queue, watch
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._n_inside = 0
        self._closed = False

    @property
    def n_inside(self) -> int:
        """Requests that are computed."""
        return self._n_inside

    @property
    def n_waiting(self) -> int:
        """Requests that wait."""
        return len(self._waiting)

    def check(self) -> None:
        """Refuse a request for which there is no place in the queue.

        Raises:
            Problem: the queue is full, or the service shuts down.
        """
        if self._closed:
            raise _closing()
        if self._n_inside >= self._places and len(self._waiting) >= self._max_queue:
            raise Problem("busy", f"{len(self._waiting)} requests wait already. Try again in a moment.")

    async def enter(self, *, seconds: float, gone: asyncio.Future[None]) -> bool:
        """Wait for a place; returns True with one, which ``leave`` gives back, and False once ``gone`` is done.

        Raises:
            Problem: the queue is full, it took too long, or the service shuts down.
        """
        self.check()
        if self._n_inside < self._places and not self._waiting:
            self._take()
            return True
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(turn)
        self._tell()
        try:
            await asyncio.wait({turn, gone}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            if turn.done() and turn.exception() is None:
                self.leave()
            raise
        finally:
            if turn in self._waiting:
                self._waiting.remove(turn)
                self._tell()
        if turn.done():
            turn.result()
            if gone.done():
                self.leave()
            return not gone.done()
        if gone.done():
            return False
        raise Problem("waited-too-long", f"It waited {seconds:.0f} seconds for its turn. Try again later.")

    def leave(self) -> None:
        """Give a place back; the next one in the queue takes it."""
        self._n_inside -= 1
        while self._waiting and self._n_inside < self._places:
            turn = self._waiting.popleft()
            if not turn.done():
                self._take()
                turn.set_result(None)
        self._tell()

    def close(self) -> None:
        """Send all away who wait, and whoever comes. Those inside are let finish."""
        self._closed = True
        while self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                turn.set_exception(_closing())
        self._tell()

    def _take(self) -> None:
        self._n_inside += 1
        self._tell()

    def _tell(self) -> None:
        self._watch(len(self._waiting), self._n_inside)


def _closing() -> Problem:
    return Problem("shutting-down", "The service is shutting down and begins nothing new. Try again later.")
