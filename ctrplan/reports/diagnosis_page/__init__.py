"""report.html of a diagnosis."""
