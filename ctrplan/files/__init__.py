"""Formats that people write and read, and the objects they stand for."""
