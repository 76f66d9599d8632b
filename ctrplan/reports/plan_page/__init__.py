"""report.html of a plan."""
