"""Motion planning for concentric tube robots with certified bounds on friction-induced error.

Names are loaded on first use, so that `import ctrplan` costs nothing that a script does not need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.base.package import __version__ as __version__
from ctrplan.base.package import homes_in, lazy_names

if TYPE_CHECKING:
    from ctrplan import planning
    from ctrplan.anatomy.fixture import Fixture as Fixture
    from ctrplan.anatomy.parts import AnatomyPart as Anatomy
    from ctrplan.anatomy.shapes.box import Box as Box
    from ctrplan.anatomy.shapes.capsule import Capsule as Capsule
    from ctrplan.anatomy.shapes.mesh import Mesh as Mesh
    from ctrplan.anatomy.shapes.sphere import Sphere as Sphere
    from ctrplan.anatomy.shapes.surface import Sheet as Sheet
    from ctrplan.anatomy.shapes.volume import Volume as Volume
    from ctrplan.audit.verify import Verification
    from ctrplan.audit.verify import verify as verify
    from ctrplan.calibration.calibrate import Calibration, calibrate
    from ctrplan.diagnosis.result import Diagnosis
    from ctrplan.diagnosis.workflow import diagnose as diagnose
    from ctrplan.drive.drive import Drive as Drive
    from ctrplan.drive.drive import Joint as Joint
    from ctrplan.drive.trajectory import Trajectory
    from ctrplan.drive.trajectory import time_parameterise as time_parameterise
    from ctrplan.errors import CtrplanError, InputError, NoAnswerError
    from ctrplan.files.file_content import as_read as as_read
    from ctrplan.files.file_content import to_toml as to_toml
    from ctrplan.files.measurement_file import load_measurements
    from ctrplan.files.plan_file import WrittenPlan, load_plan
    from ctrplan.files.plan_folder import open_plan as open_plan
    from ctrplan.files.robot_file import load_robot
    from ctrplan.files.robot_file import robot_from_dict as robot_from_dict
    from ctrplan.files.scenario_file import load_scenario
    from ctrplan.files.scenario_file import scenario_from_dict as scenario_from_dict
    from ctrplan.measurement.measurements import Marker as Marker
    from ctrplan.measurement.measurements import Measurements
    from ctrplan.measurement.measurements import SensorNoise as SensorNoise
    from ctrplan.mechanics.history import History, HistoryStep
    from ctrplan.mechanics.shapes import Bound, Bounds, Shape, Status
    from ctrplan.mechanics.tube import Contact as Contact
    from ctrplan.mechanics.tube import Loads as Loads
    from ctrplan.mechanics.tube import Tube as Tube
    from ctrplan.mechanics.tube import TubeSection as Section
    from ctrplan.motion.checker import MotionChecker as MotionChecker
    from ctrplan.patients.case import Case
    from ctrplan.patients.case import case as case
    from ctrplan.planning.base_pose import BasePose
    from ctrplan.planning.given_path import certify as certify
    from ctrplan.planning.given_path import reorder as reorder
    from ctrplan.planning.inverse_kinematics import InverseKinematics
    from ctrplan.planning.inverse_kinematics import TipTracker as TipTracker
    from ctrplan.planning.inverse_kinematics import inverse_kinematics as inverse_kinematics
    from ctrplan.planning.place import Placement
    from ctrplan.planning.place import place as place
    from ctrplan.planning.planner import plan as plan
    from ctrplan.planning.search.planners.bit_star import BITStar as BITStar
    from ctrplan.planning.search.planners.rrt_connect import RRTConnect as RRTConnect
    from ctrplan.planning.search.planners.rrt_star import RRTStar as RRTStar
    from ctrplan.plans.plan import Plan
    from ctrplan.plans.uncertainty import plan_uncertainty as plan_uncertainty
    from ctrplan.reports.check import Check
    from ctrplan.reports.check import check as check
    from ctrplan.reports.object_figures import Page
    from ctrplan.reports.object_figures import plot as plot
    from ctrplan.reports.object_figures import show as show
    from ctrplan.reports.plan_page import save_plan as save_plan
    from ctrplan.robot.robot import Robot
    from ctrplan.robot.robot import StatedIntervals as StatedIntervals
    from ctrplan.scenario.joint_space import l_shaped as l_shaped
    from ctrplan.scenario.scenario import Cost as Cost
    from ctrplan.scenario.scenario import CostTerm as CostTerm
    from ctrplan.scenario.scenario import Goal as Goal
    from ctrplan.scenario.scenario import Margins as Margins
    from ctrplan.scenario.scenario import Registration as Registration
    from ctrplan.scenario.scenario import Scenario
    from ctrplan.studies.design.tube_design import TubeDesign, TubeDesigns
    from ctrplan.studies.study.study import Study
    from ctrplan.studies.study.table import StudyTable
    from ctrplan.studies.study.table import load_study as load_study
    from ctrplan.studies.sweep import plan_many as plan_many
    from ctrplan.uncertainty.tip_slopes import bound_with_parameters as bound_with_parameters

__all__ = [
    "Anatomy",
    "BITStar",
    "BasePose",
    "Bound",
    "Bounds",
    "Box",
    "Calibration",
    "Capsule",
    "Case",
    "Check",
    "Contact",
    "Cost",
    "CostTerm",
    "CtrplanError",
    "Diagnosis",
    "Drive",
    "Fixture",
    "Goal",
    "History",
    "HistoryStep",
    "InputError",
    "InverseKinematics",
    "Joint",
    "Loads",
    "Margins",
    "Marker",
    "Measurements",
    "Mesh",
    "MotionChecker",
    "NoAnswerError",
    "Page",
    "Placement",
    "Plan",
    "RRTConnect",
    "RRTStar",
    "Registration",
    "Robot",
    "Scenario",
    "Section",
    "SensorNoise",
    "Shape",
    "Sheet",
    "Sphere",
    "StatedIntervals",
    "Status",
    "Study",
    "StudyTable",
    "TipTracker",
    "Trajectory",
    "Tube",
    "TubeDesign",
    "TubeDesigns",
    "Verification",
    "Volume",
    "WrittenPlan",
    "as_read",
    "bound_with_parameters",
    "calibrate",
    "case",
    "certify",
    "check",
    "diagnose",
    "inverse_kinematics",
    "l_shaped",
    "load_measurements",
    "load_plan",
    "load_robot",
    "load_scenario",
    "load_study",
    "open_plan",
    "place",
    "plan",
    "plan_many",
    "plan_uncertainty",
    "planning",
    "plot",
    "reorder",
    "robot_from_dict",
    "save_plan",
    "scenario_from_dict",
    "show",
    "time_parameterise",
    "to_toml",
    "verify",
]


__getattr__ = lazy_names(__name__, homes_in(__file__))


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
