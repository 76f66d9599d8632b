"""The command line in a process of its own that says when it can be interrupted."""

# What runs in the background ignores Ctrl-C, and so do its children, unless they ask for it again. One that comes
# before the command line takes care of it waits until then, which is when it imports its first command.
INTERRUPTIBLE = """
import signal, sys
from ctrplan.__main__ import main

class Ready:
    def find_spec(self, name, *_):
        if name == "ctrplan.commands.program":
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

sys.meta_path.insert(0, Ready())
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
print("up", flush=True)
sys.exit(main(sys.argv[1:]))
"""
