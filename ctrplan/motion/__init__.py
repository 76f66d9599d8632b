"""Motions of a scenario's robot: whether a straight piece of a path may be driven, and what it costs.

One call into the core a motion; search, certificate and other people's planners share the checker.
"""
