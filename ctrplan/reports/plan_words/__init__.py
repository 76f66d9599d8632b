"""The verdict on a plan in sentences."""
