"""Actuators to collars; legs and time-parameterised trajectories of the joints.

Joint values are rad or m, in the order of the drive; ruckig is imported here only.
"""
