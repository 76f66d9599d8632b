"""What a plan's uncertain parameters, registration and unexplained errors may do to its clearance and its goal."""
