"""python -m conformance, or the command `conformance`."""

import sys

from .cli import main

sys.exit(main())
