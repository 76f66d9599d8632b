"""Effects of the mechanics: which shape the tubes take.

They change the robot that is solved, or the friction state that is left when a pose is taken.
"""
