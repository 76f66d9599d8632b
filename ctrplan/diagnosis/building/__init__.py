"""Building the missing term: where something remains, a sparse term of the stage whose inputs explain it."""
