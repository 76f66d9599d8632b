"""A plan's motion as pictures and films, drawn by a small renderer of our own: no browser, no screen, no OpenGL.

docs/dependencies.md compares it with PyVista.
"""
