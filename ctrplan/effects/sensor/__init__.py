"""Effects of the sensor: what is measured of a pose.

They act last in the chain, on positions [m] and frames of the tip.
"""
