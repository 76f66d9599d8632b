"""Plan without a file: tubes, a robot, an anatomy and a goal in code, and the file that says the same."""

import math

import ctrplan
from ctrplan import Anatomy, Capsule, Contact, Goal, Robot, Scenario, Section, Sphere, Tube

outer = Tube(2.4e-3, 2.0e-3, 0.08, 0.3, (Section(0.12, 0, 4),))  # diameters [m], N m^2, Poisson's ratio
inner = Tube(1.9e-3, 1.5e-3, 0.03, 0.3, (Section(0.07, 0, 0), Section(0.08, 0, 12)), collar_length_m=0.015)
robot = Robot("my pair", (outer, inner), (Contact(0.2),))  # a rotation and a translation per tube

scenario = Scenario(
    name="past a rib",
    robot=robot,
    start=[0, 0, 0, 0],  # rad and m, in the order of robot.drive.names
    goal=Goal(joints=[0, math.pi / 2, 0, 0]),
    anatomy=(
        Anatomy(Capsule([-0.03, -0.05, 0.13], [-0.03, 0.05, 0.13], 4e-3), role="avoid", margin_m=1e-3),
        Anatomy(Sphere([0, -0.04, 0.14], 5e-3)),
    ),
)
plan = ctrplan.plan(scenario, seed=0, time_s=1)
print(f"valid: {plan.certificate.valid}, bound at the goal: {plan.certificate.goal_bound_m * 1e3:.2f} mm")

slippery = scenario.with_(robot=robot.with_("contact.1.friction_coefficient=0.05"))
print(f"with less friction: {ctrplan.certify(slippery, plan.waypoints).goal_bound_m * 1e3:.2f} mm")
print(f"the scenario's file has {len(slippery.to_toml().splitlines())} lines")
