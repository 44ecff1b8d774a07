"""Ctrl-C and SIGTERM while training: the step at hand is finished first."""

import signal
import threading
from typing import TYPE_CHECKING

from zoedepth.errors import Terminated
from zoedepth.train.processes import anywhere

if TYPE_CHECKING:
    from lightning_fabric import Fabric


class Interruption:
    """A note that this process was asked to end. Use it as a context; afterwards signals do what they did before.

    A second signal of the same kind ends the process at once. Threads other than the main one get no signals.
    """

    def __init__(self) -> None:
        self._noted: int | None = None
        self._handlers = {}

    def __enter__(self) -> "Interruption":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def asked(self, fabric: "Fabric") -> bool:
        """Return True if any process was asked to end: all of them have to stop after the same step."""
        return anywhere(self._noted is not None, fabric.device)

    def error(self, text: str) -> KeyboardInterrupt:
        """Return the error with which the run ends: that of SIGTERM where this process got it, else that of Ctrl-C."""
        return Terminated(text) if self._noted == signal.SIGTERM else KeyboardInterrupt(text)

    def _note(self, number: int, _: object) -> None:
        self._noted = number
        signal.signal(number, self._handlers[number])
