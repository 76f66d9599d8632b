"""Effects of the sensor: what is measured of a pose."""
