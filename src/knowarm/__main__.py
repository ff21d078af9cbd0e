"""``python -m knowarm`` is the same as ``knowarm``."""

import sys

from knowarm.cli.main import main

sys.exit(main())
