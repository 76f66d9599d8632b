"""A plan as a folder that 3D Slicer opens."""
