"""Effects of the drive: where collars stand when joints are commanded.

They act between the clock and the mechanics, on rotations [rad] and translations [m] of collars.
"""
