"""Where the robot could stand: base poses for the targets of a scenario, ranked by what they reach."""
