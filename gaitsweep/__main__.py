"""`python -m gaitsweep` is the command `gaitsweep`."""

import sys

from gaitsweep.pipeline.cli.commands import main

if __name__ == "__main__":
    sys.exit(main())
