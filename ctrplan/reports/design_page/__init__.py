"""report.html of a search for tube designs."""
