"""What was commanded and measured: joint paths, poses of the tip, sensors, and how each pose was approached.

Rows are in the order visited; positions are metres in the robot's frame.
"""
