# The public names and where they live.  Type checkers and editors read this file, and
# so does `_face`, which imports a name's module when the name is first asked for.

from consistent_id._support.run import large_files
from consistent_id.comparison.base_feasibility import base_feasibility
from consistent_id.comparison.comparison import Comparison, compare
from consistent_id.comparison.constraint_prices import ShadowPrice, shadow_prices
from consistent_id.comparison.fit_costs import constraint_costs
from consistent_id.comparison.fit_cross_check import CrossCheck, cross_check
from consistent_id.comparison.intervals import ConsistentIntervals, consistent_intervals
from consistent_id.comparison.parameter_uncertainty import Uncertainty, uncertainty
from consistent_id.comparison.segment_bootstrap import Bootstrap, bootstrap
from consistent_id.constraints import (
    CentreOfMassBoxes,
    CentreOfMassIn,
    DensityOn,
    Ellipsoid,
    EqualLinks,
    EqualMotors,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    FixedParameters,
    LinearRelation,
    MassBounds,
    Motor,
    NonNegativeDrive,
    ParameterBounds,
    PhysicalConsistency,
    Polytope,
    RotorInertias,
    SharedMotors,
    SymmetricLink,
    TotalMass,
    mesh_vertices,
)
from consistent_id.constraints.link_condition import LinkCondition, link_conditions
from consistent_id.constraints.priors import Penalty, PointToSet
from consistent_id.diagnosis import Diagnosis, diagnose
from consistent_id.errors import (
    ConsistentIdError,
    InfeasibleError,
    ModelError,
    NotExcitedError,
    PathError,
    ProblemError,
    RecordingError,
    SolverError,
)
from consistent_id.estimation.command_delay import CommandDelay, command_delay
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.contact_radius import (
    ContactRadius,
    contact_radius,
    with_radii,
)
from consistent_id.estimation.contradiction import Contradiction, contradiction
from consistent_id.estimation.cross_validation import (
    RegularisationPath,
    cross_validated,
)
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.estimation.cvxpy_problem import CvxpyProblem, to_cvxpy
from consistent_id.estimation.drive_calibration import (
    CalibrationFit,
    fit_calibration,
)
from consistent_id.estimation.endogeneity import EndogeneityTest, endogeneity_test
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.evidence import Evidence
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.gains import DriveGains, identify_gains
from consistent_id.estimation.instrumental import instrumental_variables
from consistent_id.estimation.joint_springs import JointSprings, joint_springs
from consistent_id.estimation.judge import judge
from consistent_id.estimation.least_squares import (
    least_squares,
    weighted_least_squares,
)
from consistent_id.estimation.payload import Payload, identify_payload
from consistent_id.estimation.rest_speed import RestSpeed, rest_speed
from consistent_id.estimation.robust import huber
from consistent_id.estimation.shapes.shape_fit import ShapeFit, fit_shapes
from consistent_id.estimation.smooth import smooth_least_squares
from consistent_id.estimation.verdict import Reason, Verdict
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.standing.feet_and_pose import (
    standing_feet,
    standing_pose,
)
from consistent_id.excitation.standing.stance import Stance, StandingFoot
from consistent_id.excitation.standing.standing_design import (
    StandingDesign,
    design_standing,
)
from consistent_id.excitation.standing.standing_limits import StandingLimits
from consistent_id.excitation.standing.standing_output import write_standing
from consistent_id.excitation.standing.trunk_path import TrunkPath
from consistent_id.excitation.validating import ValidationPath, validation_trajectory
from consistent_id.export.actuator_config import to_isaac_lab, to_mjlab
from consistent_id.export.c_source import to_c
from consistent_id.export.casadi_functions import to_casadi
from consistent_id.export.exported_file import Export
from consistent_id.export.json_record import robot_record, to_json
from consistent_id.export.lint import LintFinding, lint_robot
from consistent_id.export.mjcf_export import mujoco_spec, to_mjcf
from consistent_id.export.numpy_source import to_numpy
from consistent_id.export.pinocchio_model import to_pinocchio
from consistent_id.export.repair import Repair, nearest_inertia, repair_urdf
from consistent_id.export.urdf_export import to_urdf
from consistent_id.laboratory.inverse_kinematics import TaskPath, follow
from consistent_id.laboratory.writer import Writer
from consistent_id.laboratory.writing_tasks import Orientation, WritingTask
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Hull,
    Sphere,
    plane,
)
from consistent_id.motion.collisions.clearance import ClearanceReport, prove_clearance
from consistent_id.motion.collisions.orientation_cones import (
    OrientationCone,
    within_cones,
)
from consistent_id.motion.collisions.planning_scene import planning_scene_bodies
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.scene_building import build_scene
from consistent_id.motion.collisions.scene_file import scene_from_urdf
from consistent_id.motion.collisions.workspaces import Workspace, within_workspaces
from consistent_id.motion.files import (
    TRAJECTORY_COLUMNS,
    read_trajectory,
    write_trajectory,
)
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.motion.move import Move
from consistent_id.motion.move_along import move_along
from consistent_id.motion.polynomial_path import PolynomialPath
from consistent_id.motion.proofs.margins import MotionMargins, motion_margins
from consistent_id.motion.transfers import MotionState, transfer
from consistent_id.problems.draft import Draft
from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.fleet.fleet import fleet_estimate, identify_fleet
from consistent_id.problems.fleet.fleet_result import Fleet, FleetRobot
from consistent_id.problems.fleet.found_payload import FoundPayload
from consistent_id.problems.fleet.payloads import CarriedBody
from consistent_id.problems.floating.hints import BaseHints
from consistent_id.problems.loading import load_problem
from consistent_id.problems.log_identification import identify_log
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import identify
from consistent_id.problems.selection.select import select_model
from consistent_id.problems.selection.selection import ModelSelection
from consistent_id.problems.several import load_problems
from consistent_id.problems.streaming.stream import stream_regression
from consistent_id.problems.streaming.stream_estimate import stream_estimate
from consistent_id.problems.study import Study, run_study
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.recordings.contacts import ContactFlags, Wrench
from consistent_id.recordings.readers import (
    JOINT_STATE,
    BaseColumns,
    BesideColumns,
    Columns,
    ContactColumns,
    WrenchColumns,
    read_recording,
    read_track,
    recording_from,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    Delay,
    DriveCalibration,
    Fold,
    FourierFit,
    MotionNoise,
    PDGains,
    Track,
    aligned,
    blocked_folds,
    calibrated,
    commanded,
    decimated,
    differentiated,
    encoder_resolution,
    estimate_delay,
    estimated_period,
    faster,
    fit_trajectory,
    fourier_differentiated,
    fourier_fit,
    impact_guard,
    kalman_differentiated,
    low_passed,
    mask_onto,
    motion_noise,
    resampled,
    rest_guard,
    row_weights,
    saturated,
    savitzky_golay_differentiated,
    speed_share,
    split_at_gaps,
    standstill,
    there_and_back,
    track,
    trim_standstill,
    trimmed,
    without,
    without_impacts,
    without_rests,
)
from consistent_id.recordings.signals.base_signals import (
    base_from_imu,
    base_from_pose,
    rotations,
)
from consistent_id.recordings.trajectory import FourierTrajectory, harmonics_of
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    condition_number,
)
from consistent_id.regression.casadi_regressor import casadi_regressor
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.term import DriveTerm, JointSamples, ShapeParameter
from consistent_id.regression.friction_shapes import shapes_of, with_shapes
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regression_file import load_regression, save_regression
from consistent_id.regression.regressor import (
    TorqueModel,
    joint_torque_regressor,
)
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.regression.rows.contact_free import (
    contact_free_base,
    contact_free_model,
    contact_free_regression,
)
from consistent_id.regression.rows.contact_maps import contact_force_left, row_levels
from consistent_id.regression.rows.generalised_forces import contact_jacobian
from consistent_id.regression.rows.given_rows import GivenRows, given_rows
from consistent_id.regression.rows.sensor_drift import SensorBias
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.regression.rows.slip import contact_slip, without_slip
from consistent_id.regression.rows.wrench_sensor import (
    sensor_bias,
    sensor_motion,
    sensor_regression,
    static_poses,
    tool_model,
)
from consistent_id.regression.segments import segment_regressions, segment_sources
from consistent_id.regression.simulation import simulate_torque
from consistent_id.report import (
    Advice,
    advise,
    comparison_html,
    report_html,
    write_report,
)
from consistent_id.robot.chains import chain, held
from consistent_id.robot.free_bodies import free_bodies
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import frame_places
from consistent_id.robot.loaders import (
    DHRow,
    Finding,
    from_classical_dh,
    from_modified_dh,
    lint_urdf,
    load_mjcf,
    load_robot,
    load_urdf,
)
from consistent_id.robot.log_cholesky import (
    body_from_log_cholesky,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)
from consistent_id.robot.mimic import Mimic
from consistent_id.robot.model import (
    Datasheet,
    FixedFrame,
    Joint,
    JointLimits,
    Link,
    RobotModel,
)

__version__: str

__all__ = [
    "BASE_ROWS",
    "JOINT_STATE",
    "TRAJECTORY_COLUMNS",
    "Advice",
    "Aim",
    "BaseColumns",
    "BaseHints",
    "BaseMotion",
    "BaseParameters",
    "BesideColumns",
    "Body",
    "Bootstrap",
    "Box",
    "CalibrationFit",
    "Capsule",
    "CarriedBody",
    "CentreOfMassBoxes",
    "CentreOfMassIn",
    "Certificate",
    "ClearanceReport",
    "Columns",
    "CommandDelay",
    "Comparison",
    "ConsistentIdError",
    "ConsistentIntervals",
    "ContactColumns",
    "ContactFlags",
    "ContactRadius",
    "Contradiction",
    "CrossCheck",
    "CutoffChoice",
    "CvxpyProblem",
    "Cylinder",
    "DHRow",
    "Datasheet",
    "Delay",
    "DensityOn",
    "Diagnosis",
    "Draft",
    "DriveCalibration",
    "DriveGains",
    "DriveTerm",
    "DriveTerms",
    "Ellipsoid",
    "EndogeneityTest",
    "EqualLinks",
    "EqualMotors",
    "Estimate",
    "Evidence",
    "ExcitationDesign",
    "Export",
    "Finding",
    "Fit",
    "FixedBodies",
    "FixedCentresOfMass",
    "FixedFrame",
    "FixedMasses",
    "FixedParameters",
    "Fleet",
    "FleetRobot",
    "Fold",
    "FoundPayload",
    "FourierFit",
    "FourierTrajectory",
    "GearCoupling",
    "GivenRows",
    "HalfSpace",
    "Hull",
    "InertialParameters",
    "InfeasibleError",
    "Joint",
    "JointLimits",
    "JointSamples",
    "JointSprings",
    "LinearRelation",
    "Link",
    "LinkCondition",
    "LintFinding",
    "MassBounds",
    "Mimic",
    "ModelError",
    "ModelSelection",
    "MotionLimits",
    "MotionMargins",
    "MotionNoise",
    "MotionState",
    "Motor",
    "Move",
    "NonNegativeDrive",
    "NotExcitedError",
    "Orientation",
    "OrientationCone",
    "PDGains",
    "ParameterBounds",
    "PathError",
    "PathForm",
    "Payload",
    "Penalty",
    "PhysicalConsistency",
    "PointToSet",
    "PolynomialPath",
    "Polytope",
    "PredictedAccuracy",
    "Problem",
    "ProblemError",
    "Reason",
    "Recording",
    "RecordingError",
    "Regression",
    "RegularisationPath",
    "Repair",
    "RestSpeed",
    "RobotModel",
    "RotorInertias",
    "Scene",
    "SensorBias",
    "SensorRows",
    "ShadowPrice",
    "ShapeFit",
    "ShapeParameter",
    "SharedMotors",
    "SolverError",
    "Sphere",
    "Stance",
    "StandingDesign",
    "StandingFoot",
    "StandingLimits",
    "Study",
    "SymmetricLink",
    "TaskPath",
    "TorqueModel",
    "TotalMass",
    "Track",
    "TrunkPath",
    "Uncertainty",
    "ValidationPath",
    "Verdict",
    "Workspace",
    "Wrench",
    "WrenchColumns",
    "Writer",
    "WritingTask",
    "advise",
    "aligned",
    "base_feasibility",
    "base_from_imu",
    "base_from_pose",
    "base_parameters",
    "best_cutoff",
    "blocked_folds",
    "body_from_log_cholesky",
    "bootstrap",
    "build_regression",
    "build_scene",
    "calibrated",
    "casadi_regressor",
    "chain",
    "command_delay",
    "commanded",
    "compare",
    "comparison_html",
    "condition_number",
    "consistent_intervals",
    "constrained_least_squares",
    "constraint_costs",
    "contact_force_left",
    "contact_free_base",
    "contact_free_model",
    "contact_free_regression",
    "contact_jacobian",
    "contact_radius",
    "contact_slip",
    "contradiction",
    "cross_check",
    "cross_validated",
    "decimated",
    "design_standing",
    "design_trajectory",
    "diagnose",
    "differentiated",
    "draft_problem",
    "encoder_resolution",
    "endogeneity_test",
    "estimate_delay",
    "estimated_period",
    "faster",
    "fit_calibration",
    "fit_shapes",
    "fit_trajectory",
    "fleet_estimate",
    "follow",
    "fourier_differentiated",
    "fourier_fit",
    "frame_places",
    "free_bodies",
    "from_classical_dh",
    "from_modified_dh",
    "given_rows",
    "harmonics_of",
    "held",
    "huber",
    "identify",
    "identify_fleet",
    "identify_gains",
    "identify_log",
    "identify_payload",
    "impact_guard",
    "instrumental_variables",
    "joint_noise",
    "joint_springs",
    "joint_torque_regressor",
    "judge",
    "kalman_differentiated",
    "large_files",
    "least_squares",
    "link_conditions",
    "lint_robot",
    "lint_urdf",
    "load_mjcf",
    "load_problem",
    "load_problems",
    "load_regression",
    "load_robot",
    "load_urdf",
    "log_cholesky_from_body",
    "log_cholesky_jacobian",
    "low_passed",
    "mask_onto",
    "mesh_vertices",
    "motion_limits",
    "motion_margins",
    "motion_noise",
    "move_along",
    "mujoco_spec",
    "nearest_inertia",
    "plane",
    "planning_scene_bodies",
    "predicted_accuracy",
    "prove_clearance",
    "read_recording",
    "read_track",
    "read_trajectory",
    "recording_from",
    "repair_urdf",
    "report_html",
    "resampled",
    "rest_guard",
    "rest_speed",
    "robot_record",
    "rotations",
    "row_levels",
    "row_weights",
    "run_study",
    "saturated",
    "save_regression",
    "savitzky_golay_differentiated",
    "scene_from_urdf",
    "segment_regressions",
    "segment_sources",
    "select_model",
    "sensor_bias",
    "sensor_motion",
    "sensor_regression",
    "shadow_prices",
    "shapes_of",
    "simulate_torque",
    "smooth_least_squares",
    "speed_share",
    "split_at_gaps",
    "standing_feet",
    "standing_pose",
    "standstill",
    "static_poses",
    "stream_estimate",
    "stream_regression",
    "there_and_back",
    "to_c",
    "to_casadi",
    "to_cvxpy",
    "to_isaac_lab",
    "to_json",
    "to_mjcf",
    "to_mjlab",
    "to_numpy",
    "to_pinocchio",
    "to_urdf",
    "tool_model",
    "track",
    "transfer",
    "trim_standstill",
    "trimmed",
    "uncertainty",
    "validation_trajectory",
    "weighted_least_squares",
    "with_radii",
    "with_shapes",
    "within_cones",
    "within_workspaces",
    "without",
    "without_impacts",
    "without_rests",
    "without_slip",
    "write_report",
    "write_standing",
    "write_trajectory",
]
