"""The Python face of the compiled model: tubes, shapes, bounds, histories."""
