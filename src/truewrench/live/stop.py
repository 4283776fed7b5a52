"""A clean end: SIGINT, SIGTERM and SIGHUP are asked about between samples and never interrupt one."""

import os
import signal
import threading
from contextlib import suppress
from types import FrameType
from typing import Any, Self


class Stop:
    """Whether the program was asked to end; a context in which the signals say so and do no more.

    A second Ctrl-C is an ordinary one again, for a user who does not want to wait for a last result. Outside
    the main thread, where Python hears no signals, only `request` ends anything.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._wake, self._woken = os.pipe()
        if threading.current_thread() is threading.main_thread():
            os.set_blocking(self._woken, False)
            self._before_wakeup = signal.set_wakeup_fd(self._woken, warn_on_full_buffer=False)
            for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                if name == signal.SIGHUP and signal.getsignal(name) == signal.SIG_IGN:
                    continue  # of nohup
                self._before[name] = signal.signal(name, self._heard)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before:
            signal.set_wakeup_fd(self._before_wakeup)
        for name, handler in self._before.items():
            signal.signal(name, handler)
        os.close(self._wake)
        os.close(self._woken)

    def request(self) -> None:
        """End as a signal would; from any thread."""
        self.requested = True
        with suppress(BlockingIOError):
            os.write(self._woken, b"\0")

    def fileno(self) -> int:
        """Readable, for `select`, once the end was asked for."""
        return self._wake

    def _heard(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
