"""The search for a path, by OMPL's planners and by a roadmap.

The only package that imports OMPL.
"""
