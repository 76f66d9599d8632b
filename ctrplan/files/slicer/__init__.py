"""Files of 3D Slicer: text and bytes of what it reads, made without it."""
