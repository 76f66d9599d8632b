"""Tube designs: a search over what can be made, for a set of targets in an anatomy, with its trade-off front."""
