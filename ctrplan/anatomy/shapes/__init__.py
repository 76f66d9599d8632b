"""The kinds of obstacles and lumens, one file each."""
