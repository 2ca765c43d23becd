from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.estimation.base_least_squares import (
    least_squares,
    weighted_least_squares,
)
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.constrained_fit import (
    Contradiction,
    contradiction,
)
from consistent_id.estimation.cross_validation import (
    RegularisationPath,
    cross_validated,
)
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.estimation.cvxpy_problem import CvxpyProblem, to_cvxpy
from consistent_id.estimation.delayed_commands import CommandDelay, command_delay
from consistent_id.estimation.drive_calibration import CalibrationFit, fit_calibration
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.gains import DriveGains, identify_gains
from consistent_id.estimation.instrumental import (
    EndogeneityTest,
    endogeneity_test,
    instrumental_variables,
)
from consistent_id.estimation.judgement import Evidence, judge
from consistent_id.estimation.payload import Payload, identify_payload
from consistent_id.estimation.radius_and_delay import (
    ContactRadius,
    RadiusAndDelay,
    TorqueDelay,
    contact_radius,
    estimate_radius_and_delay,
    with_radii,
    without_torque_delay,
)
from consistent_id.estimation.resting import RestSpeed, rest_speed
from consistent_id.estimation.robust import huber
from consistent_id.estimation.shape_fit import ShapeFit, fit_shapes
from consistent_id.estimation.transmission_springs import JointSprings, joint_springs
from consistent_id.estimation.verdict import Reason, Verdict

__all__ = [
    "CalibrationFit",
    "Certificate",
    "CommandDelay",
    "ContactRadius",
    "Contradiction",
    "CutoffChoice",
    "CvxpyProblem",
    "DriveGains",
    "EndogeneityTest",
    "Estimate",
    "Evidence",
    "Fit",
    "JointSprings",
    "Payload",
    "RadiusAndDelay",
    "Reason",
    "RegularisationPath",
    "RestSpeed",
    "ShapeFit",
    "TorqueDelay",
    "Verdict",
    "best_cutoff",
    "command_delay",
    "constrained_least_squares",
    "contact_radius",
    "contradiction",
    "cross_validated",
    "endogeneity_test",
    "estimate_radius_and_delay",
    "fit_calibration",
    "fit_shapes",
    "huber",
    "identify_gains",
    "identify_payload",
    "instrumental_variables",
    "joint_springs",
    "judge",
    "least_squares",
    "rest_speed",
    "to_cvxpy",
    "weighted_least_squares",
    "with_radii",
    "without_torque_delay",
]
