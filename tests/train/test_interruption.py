"""The step at hand is finished after a signal; a second one ends the process at once."""

import signal
import threading

import pytest

from zoedepth.errors import Terminated
from zoedepth.train import processes
from zoedepth.train.interruption import Interruption


class Device:
    """Fabric's place in this file."""

    device = "cpu"


SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])


@SIGNALS
def test_a_signal_is_noted_and_the_handlers_are_put_back(number: int) -> None:
    before = [signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)]
    with Interruption() as noted:
        assert not noted.asked(Device())
        signal.raise_signal(number)
        assert noted.asked(Device())
    assert [signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)] == before


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_the_error_tells_which_signal_it_was(number: int, kind: type[KeyboardInterrupt]) -> None:
    with Interruption() as noted:
        signal.raise_signal(number)
        assert type(noted.error("step 2 is saved")) is kind
        assert str(noted.error("step 2 is saved")) == "step 2 is saved"


def test_a_second_signal_does_what_it_did_before() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # programs in the background may ignore Ctrl-C
    try:
        with Interruption() as noted:
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            assert noted.asked(Device())
    finally:
        signal.signal(signal.SIGINT, before)


def test_handlers_are_put_back_after_an_error() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(ZeroDivisionError), Interruption():
        _ = 1 / 0
    assert signal.getsignal(signal.SIGTERM) is before


def test_other_threads_than_the_main_one_can_train() -> None:
    found = []

    def work() -> None:
        with Interruption() as noted:
            found.append(noted.asked(Device()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [False]


def test_all_processes_stop_if_one_was_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "several_processes", lambda: True)
    with Interruption() as noted:
        monkeypatch.setattr(processes, "total", lambda mine: mine + 1)  # another process got a signal
        assert noted.asked(Device())
        monkeypatch.setattr(processes, "total", lambda mine: mine)
        assert not noted.asked(Device())
