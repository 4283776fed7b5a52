"""When stamps that go back are another run of their source, and no disorder."""

from truewrench.model.errors import InputError

RESTART = 1_000_000_000  # [ns] back in time


class BeganAgainError(InputError):
    """The stamps of a stream went back by more than that."""
