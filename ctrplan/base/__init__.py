"""What every package uses and that knows none of them.

Arrays and units, arguments of public functions, catalogues, surfaces of triangles, work that takes long.
"""
