"""`python -m rangecam` is the command line."""

import sys

from rangecam.cli import main

sys.exit(main())
