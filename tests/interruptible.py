"""The command line in a process of its own that says when it can be interrupted."""

# What runs in the background ignores Ctrl-C, and so do its children, unless they ask for it again.
INTERRUPTIBLE = """
import signal, sys
from ctrplan.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
print("up", flush=True)
sys.exit(main(sys.argv[1:]))
"""
