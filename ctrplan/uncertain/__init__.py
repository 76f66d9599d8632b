"""Numbers of a robot that are known by intervals only, and what they may do to its tips and bounds."""
