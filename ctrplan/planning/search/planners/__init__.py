"""The planners that search over L-shaped motions, one file each."""
