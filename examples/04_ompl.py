"""The friction bound as the objective of an OMPL set-up of one's own."""

from pathlib import Path

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

import ctrplan
from ctrplan.planning import MotionChecker, MotionValidity, StateReader, Validity, state_space

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"

ou.RNG.setSeed(1)
scenario = ctrplan.load_scenario(SCENARIOS / "pair_free.toml")
checker = MotionChecker(scenario)  # limits, nesting, stability, strain, clearance
information = ob.SpaceInformation(state_space(checker.space))
read = StateReader(checker.space)  # OMPL's states <-> joint values [rad, m]
validity, motions = Validity(information, checker, read), MotionValidity(information, checker, read)
information.setStateValidityChecker(validity)
information.setMotionValidator(motions)
information.setup()

start, goal = information.allocState(), information.allocState()
read.write(start, scenario.start)
read.write(goal, scenario.goal.joints)
objective = ctrplan.planning.BoundObjective(information, scenario, goals=[read(goal)])
definition = ob.ProblemDefinition(information)
definition.setStartAndGoalStates(start, goal)
definition.setOptimizationObjective(objective)

planner = og.RRTConnect(information)  # or any other
planner.setRange(information.getStateSpace().getMaximumExtent())  # a motion is dear to check, long or short
planner.setProblemDefinition(definition)
planner.solve(ob.PlannerTerminationCondition(definition.hasExactSolution))
states = definition.getSolutionPath().getStates()
cost = sum(objective.motionCost(a, b).value() for a, b in zip(states[:-1], states[1:], strict=True))
print(f"{len(states)} states, path with friction costs {cost:.1f} mm")
