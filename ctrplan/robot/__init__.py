"""Tubes, contacts and drive as one object, and an observer that follows it.

A `Robot` answers questions of shape and bound; its named numbers can be read and changed.
"""
