"""plan.png, simulation.png, sweep.png."""
