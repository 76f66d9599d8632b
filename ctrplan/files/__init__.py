"""Formats that people write and read, and the objects they stand for.

Every fault is one sentence with file, key, value and rule; files say units in their keys, objects are SI.
"""
