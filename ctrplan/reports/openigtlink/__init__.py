"""Poses over OpenIGTLink, which 3D Slicer and other programs of the operating room listen to."""
