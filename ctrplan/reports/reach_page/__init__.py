"""report.html of inverse kinematics."""
