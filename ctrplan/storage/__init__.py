"""Bytes and syntax on disk: TOML documents, CSV tables, atomic writes, caches, temporary files."""
