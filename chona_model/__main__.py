"""``python -m chona_model``: the same as the command ``chona``."""

import sys

from chona_model.cli import main

if __name__ == "__main__":
    sys.exit(main())
