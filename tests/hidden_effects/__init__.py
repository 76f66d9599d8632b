"""Measured data of a robot that differs from what its user believes: made by discrete rods, sharing nothing with ctrplan.

The way of a joint command: drive -> mechanics (chains of rigid links in curvature coordinates, interior-point contact) ->
sensor -> noise -> measurements.csv. Effects are switched on by name: effects.py. `python -m hidden_effects.bank` draws a
bank of cases; run from tests/.
"""
