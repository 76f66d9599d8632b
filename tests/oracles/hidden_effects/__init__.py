"""Measured data of a robot that differs from what its user believes: by discrete rods, apart from ctrplan.

The way of a joint command: drive -> mechanics (chains of rigid links in curvature coordinates, interior-point contact)
-> sensor -> noise -> measurements.csv. Effects are switched on by name (effects.py). From tests/:
`python -m hidden_effects.bank make DIR` makes a bank, `hidden_effects.run` diagnoses it, `hidden_effects.score` prints
the table of goals, `hidden_effects.discretisation` the generator's own error.
"""
