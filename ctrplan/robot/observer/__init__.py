"""Following a robot: friction states that agree with measured tips, and where the tip is then."""
