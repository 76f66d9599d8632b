"""Tube designs: a search over what can be made, for a set of targets in an anatomy, with its trade-off front.

`ctrplan.TubeDesign` is the public class; docs/tube_design.md has the file's keys.
"""
