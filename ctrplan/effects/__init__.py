"""What a robot may have beside the ideal model: a file an effect, a folder a stage.

`ctrplan.effects.effect` says what an effect states of itself; docs/effects.md lists all of them.
"""
