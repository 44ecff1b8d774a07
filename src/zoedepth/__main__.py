"""``python -m zoedepth`` is ``zoedepth``."""

import sys

from zoedepth.cli import main

sys.exit(main())
