"""The planners that search over L-shaped motions, one file each.

`planner.name` of a scenario names one; see `PlannerSettings` of `ctrplan.scenario.scenario`.
"""
