"""What must not be touched: parts, meshes, and the clearance they leave to a point."""
