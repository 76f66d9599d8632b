"""Poses of the tip and what a tracker makes of them."""
