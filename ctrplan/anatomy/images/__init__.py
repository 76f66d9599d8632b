"""Volumes: images of a patient read, a structure in them chosen, and its surface between the voxels found."""
