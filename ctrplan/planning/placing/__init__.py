"""Where the robot could stand: base poses for the targets of a scenario, tried cheaply first, ranked by what they reach."""
