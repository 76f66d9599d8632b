"""What was commanded and measured."""
