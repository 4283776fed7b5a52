"""A stream ends cleanly at the signals that end programs, and not at one that was to be ignored."""

import os
import signal

import pytest

from truewrench.live.stop import Stop


@pytest.mark.parametrize("name", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_asks_for_the_end_and_does_no_more(name: signal.Signals) -> None:
    with Stop() as stop:
        os.kill(os.getpid(), name)
        assert stop.requested


def test_a_hangup_that_nohup_has_ignored_ends_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Stop() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stop.requested
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
