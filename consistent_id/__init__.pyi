from consistent_id import comparison as comparison
from consistent_id import constraints as constraints
from consistent_id import diagnosis as diagnosis
from consistent_id import estimation as estimation
from consistent_id import excitation as excitation
from consistent_id import export as export
from consistent_id import fleet as fleet
from consistent_id import laboratory as laboratory
from consistent_id import motion as motion
from consistent_id import problems as problems
from consistent_id import recordings as recordings
from consistent_id import regression as regression
from consistent_id import repair as repair
from consistent_id import report as report
from consistent_id import robot as robot
from consistent_id import rollout as rollout
from consistent_id import signals as signals
from consistent_id import standing as standing
from consistent_id._support.run import large_files
from consistent_id.comparison.comparison import Comparison, compare
from consistent_id.constraints import (
    FixedMasses,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    RotorInertias,
)
from consistent_id.diagnosis import diagnose
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
from consistent_id.estimation.base_least_squares import least_squares
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.robust import huber
from consistent_id.estimation.uncertainties.parameter_uncertainty import (
    Uncertainty,
    uncertainty,
)
from consistent_id.estimation.verdict import Verdict
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.export.mjcf_export import to_mjcf
from consistent_id.export.urdf_export import to_urdf
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.loading import load_problem
from consistent_id.problems.opening import identify_log
from consistent_id.problems.problem import Problem
from consistent_id.problems.statement import Statement
from consistent_id.problems.study import Study, run_study
from consistent_id.recordings.readers import Columns, read_recording, recording_from
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    differentiated,
    low_passed,
    resampled,
    trimmed,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.torque_along import simulate_torque
from consistent_id.report.page import write_report
from consistent_id.report.results import Results, open_results
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh, load_robot
from consistent_id.robot.model import RobotModel

__version__: str

__all__ = [
    "Aim",
    "Columns",
    "Comparison",
    "ConsistentIdError",
    "DHRow",
    "DriveTerms",
    "Estimate",
    "ExcitationDesign",
    "FixedMasses",
    "InertialParameters",
    "InfeasibleError",
    "MassBounds",
    "ModelError",
    "MotionLimits",
    "NonNegativeDrive",
    "NotExcitedError",
    "PathError",
    "PathForm",
    "PhysicalConsistency",
    "Problem",
    "ProblemError",
    "Recording",
    "RecordingError",
    "Regression",
    "Results",
    "RobotModel",
    "RotorInertias",
    "SolverError",
    "Statement",
    "Study",
    "TorqueModel",
    "Uncertainty",
    "Verdict",
    "build_regression",
    "compare",
    "constrained_least_squares",
    "design_trajectory",
    "diagnose",
    "differentiated",
    "draft_problem",
    "from_modified_dh",
    "huber",
    "identify_log",
    "large_files",
    "least_squares",
    "load_problem",
    "load_robot",
    "low_passed",
    "motion_limits",
    "open_results",
    "read_recording",
    "recording_from",
    "resampled",
    "run_study",
    "simulate_torque",
    "to_mjcf",
    "to_urdf",
    "trimmed",
    "uncertainty",
    "write_report",
]
