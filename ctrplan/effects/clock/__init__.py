"""Effects of the clock: which instant a pose belongs to."""
