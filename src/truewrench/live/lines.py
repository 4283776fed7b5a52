"""Lines of a pipe as they arrive, and lines into one."""

import os
import select
import sys
from collections.abc import Iterator

from truewrench.live.stop import Stop

LONGEST = 1 << 20  # bytes of a line: nothing that is longer is one

_BLOCK = 1 << 16


def batches(source: int, stop: Stop, wait: float | None = None) -> Iterator[list[bytes]]:
    """The lines of a file descriptor, as many as have arrived, until its end or until `stop`.

    A line that does not end within `LONGEST` bytes is cut there, and its rest left out. What has been read by
    then has been given out. After `wait` without a line [s], by default never, the batch is empty.
    """
    rest, skipping = b"", False
    while not stop.requested:
        ready, _, _ = select.select([source, stop.fileno()], [], [], wait)
        if source not in ready:
            yield []
            continue
        block = os.read(source, _BLOCK)
        if not block:
            break
        *lines, rest = (rest + block).split(b"\n")
        if skipping and lines:
            lines, skipping = lines[1:], False
        if len(rest) > LONGEST:
            lines, rest = lines if skipping else [*lines, rest], b""
            skipping = True
        yield lines
    if rest and not stop.requested and not skipping:
        yield [rest]


class Output:
    """Standard output, line by line, each on its way before the next is made."""

    def __init__(self, silent: bool = False) -> None:
        self.closed = False  # whether its reader has gone; what is written then is lost, and no error
        self._silent = silent

    def write(self, line: str) -> None:
        """Write one line, given without its end."""
        if self._silent or self.closed:
            return
        try:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
        except BrokenPipeError:
            self.closed = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
