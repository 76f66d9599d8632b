"""What the commands of the command line do; `program` reads their arguments."""
