"""Scenarios: a robot in an anatomy, where it starts and where it shall go, and what follows from these alone.

Joint space, inverse kinematics without clearance, and histories simulated along a path need nothing else.
"""
