"""Where the command line begins, `python -m ctrplan` too. Nothing is imported before Ctrl-C is taken care of."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence

LINEAR_ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # read when numpy is imported
COLLECT_EVERY = 20_000  # objects made, a budget: imports make more than that and next to no rubbish


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns its exit code: 0 done, 1 no answer, 2 malformed input, 130 interrupted.

    Linear algebra has one thread unless the environment says otherwise: threads wait for each other over matrices as
    small as these, and take the processor from the work that commands share among threads themselves.
    """
    for variable in LINEAR_ALGEBRA:
        os.environ.setdefault(variable, "1")
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
