"""The chain: commanded joints -> clock -> drive -> mechanics -> sensor.

What is predicted of a measurement, with derivatives by the parameters of every effect.
"""
