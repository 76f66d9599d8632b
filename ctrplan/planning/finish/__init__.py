"""What happens to a path that was found: order, oscillation, compensation."""
