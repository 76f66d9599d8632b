"""What the commands of the command line do; `ctrplan.cli` reads their arguments."""
