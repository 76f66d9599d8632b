"""What can be done with every combination of a study, a file each."""
