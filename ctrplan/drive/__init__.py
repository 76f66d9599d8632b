"""Actuators to collars; legs and time-parameterised trajectories of the joints."""
