"""Motions of a scenario's robot: whether a straight piece of a path may be driven, and what it costs."""
