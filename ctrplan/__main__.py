"""Where `python -m ctrplan` begins."""

import sys

from ctrplan.cli import main

if __name__ == "__main__":
    sys.exit(main())
