"""Tubes, contacts and drive as one object."""
