"""Where the command line begins, `python -m ctrplan` too. Nothing is imported before Ctrl-C is taken care of."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence

COLLECT_EVERY = 20_000  # objects made, a budget: imports make more than that and next to no rubbish


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns its exit code: 0 done, 1 no answer, 2 malformed input, 130 interrupted."""
    gc.set_threshold(COLLECT_EVERY)
    try:
        from ctrplan.base.long_work import interrupts_noticed
        from ctrplan.commands.program import run

        with interrupts_noticed():
            return run(arguments)
    except KeyboardInterrupt:
        print("ctrplan: interrupted before there was a result.", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
