"""Bytes and syntax on disk: TOML documents, CSV tables, atomic writes, caches, temporary files.

Nothing here knows what a robot is.
"""
