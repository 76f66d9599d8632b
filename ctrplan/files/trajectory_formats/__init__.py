"""The formats in which a trajectory is written, one file each."""
