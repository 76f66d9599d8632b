"""How likely the tip misses the targets of a motion: drawn robots, solved, simulated and judged at each."""
