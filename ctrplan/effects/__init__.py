"""What a robot may have beside the ideal model: a file an effect, a folder a stage."""
