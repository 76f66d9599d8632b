"""What must not be touched: parts, meshes, volumes, and the clearance they leave to a point.

Frames are the scenario's; lengths are metres. Kinds of obstacles and lumens are one file each in `shapes`.
"""
