"""What the commands of the command line do, a file each; `program` reads their arguments.

A command imports what it needs when it runs, so that `ctrplan --help` waits for nothing.
"""
