"""The Python face of the compiled model: tubes, shapes, bounds, histories.

The only package besides `anatomy` that calls the core; SI units, outermost tube first.
"""
