"""Anatomies of the scenarios, a file each; `scenarios/make_meshes.py` writes them."""
