"""Terms that a diagnosis built from measurements: [effects.learned_NAME] of a robot file. They name no cause."""
