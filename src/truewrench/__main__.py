"""`python -m truewrench`: the command."""

import sys

from truewrench.cli import main

if __name__ == "__main__":  # processes that a campaign starts import it, too
    sys.exit(main())
