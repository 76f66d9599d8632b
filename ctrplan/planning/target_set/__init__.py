"""What a robot is worth for a set of targets: reach, error whatever friction does, stability, cost of tolerances."""
