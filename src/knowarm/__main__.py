"""``python -m knowarm`` is the same as ``knowarm``."""

import sys

from knowarm.cli.main import main

if __name__ == "__main__":  # processes that a command starts import this module again
    sys.exit(main())
