"""Terms that a diagnosis built from measurements: [effects.learned_NAME] of a robot file. They name no cause.

A term acts on a stage, by parts that depend on inputs within the ranges of the data.
"""
