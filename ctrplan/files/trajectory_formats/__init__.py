"""The formats in which a trajectory is written, one file each.

A format is a function from a trajectory to text, see `ctrplan.files.trajectory_file`.
"""
