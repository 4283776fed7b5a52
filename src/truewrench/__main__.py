"""`python -m truewrench`: the command."""

import sys

from truewrench.cli import main

__all__: list[str] = []

if __name__ == "__main__":  # processes that a campaign starts import it, too
    sys.exit(main())
