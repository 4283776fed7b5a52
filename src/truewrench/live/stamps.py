"""When stamps that go back are another run of their source, and no disorder."""

from truewrench.model.errors import InputError

RESTART = 1_000_000_000  # [ns] back in time


class BeganAgainError(InputError):
    """The stamps of a stream went back by more than that."""


class Order:
    """Stamps that increase; a source that begins again, far back, is let through."""

    def __init__(self) -> None:
        self.last: int | None = None  # [ns] of what was used

    def check(self, stamp: int, place: str) -> bool:
        """Whether stamps begin again with this one; InputError: it is out of order."""
        last = self.last
        if last is None or stamp > last:
            return False
        if stamp > last - RESTART:
            raise InputError(f"{place}: found {stamp} ns after {last} ns, expected time that increases")
        return True
