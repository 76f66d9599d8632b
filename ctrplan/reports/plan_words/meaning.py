"""What the figures of a plan mean, and what they do not cover."""

from __future__ import annotations

MEANING = (
    "Friction between the tubes makes the robot's shape depend on how it got there: the same joint values can "
    "give many shapes. At every sampled place of the path the model was solved without friction, and with "
    "friction at its Coulomb limit in every combination of directions (the corner shapes). The worst-case "
    "friction error is the largest distance of the tip in a corner shape from the tip without friction. The "
    "envelope is that distance all along the robot, with the tubes' radius and the model error added.",
    "Clearance, stability and strain are those of every friction state, not of these shapes alone: of the states "
    "between them the certificate solves as many as it takes for what lies between solved shapes to be safe.",
    "The predicted friction error follows the contacts' slip along this very path, from every friction state that the "
    "robot may start in (released, and every corner); the largest counts. Rotations load friction, translations "
    "release it, so that it is usually far below the worst case where a plan ends with a translation.",
    "What the figures do not cover: the model is quasi-static (slow motion, no vibration), friction follows "
    "Coulomb's law with the coefficients of the robot file, and nothing touches the robot from outside, neither "
    "anatomy nor tools. They hold for the model as calibrated; what calibration could not explain is in the robot "
    "file's model error and nowhere else. That no history of motion takes the tip beyond the corner shapes is "
    "supported by trials, not proved; for bodies, friction that differs along a contact has an allowance that was "
    "measured.",
)
