"""Effects of the clock: which instant a pose belongs to.

They act first in the chain, on the joints that were commanded.
"""
