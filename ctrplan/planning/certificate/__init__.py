"""The dense recheck of a finished path, and the simulated histories along it."""
