from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    condition_number,
)
from consistent_id.regression.casadi_rows import casadi_regressor
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.term import DriveTerm, JointSamples, ShapeParameter
from consistent_id.regression.friction_shapes import shapes_of, with_shapes
from consistent_id.regression.given_regression import (
    GivenRows,
    given_rows,
    load_regression,
    save_regression,
)
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel, joint_torque_regressor
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.regression.rows.contact_free import (
    contact_free_base,
    contact_free_model,
    contact_free_regression,
)
from consistent_id.regression.rows.contact_maps import (
    contact_force_left,
    contact_slip,
    row_levels,
    without_slip,
)
from consistent_id.regression.rows.generalised_forces import contact_jacobian
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.regression.rows.wrench_sensor import (
    SensorBias,
    sensor_bias,
    sensor_motion,
    sensor_regression,
    static_poses,
    tool_model,
)
from consistent_id.regression.segments import segment_regressions, segment_sources
from consistent_id.regression.torque_along import simulate_torque

__all__ = [
    "BASE_ROWS",
    "BaseParameters",
    "DriveTerm",
    "DriveTerms",
    "GearCoupling",
    "GivenRows",
    "JointSamples",
    "Regression",
    "SensorBias",
    "SensorRows",
    "ShapeParameter",
    "TorqueModel",
    "base_parameters",
    "build_regression",
    "casadi_regressor",
    "condition_number",
    "contact_force_left",
    "contact_free_base",
    "contact_free_model",
    "contact_free_regression",
    "contact_jacobian",
    "contact_slip",
    "given_rows",
    "joint_noise",
    "joint_torque_regressor",
    "load_regression",
    "row_levels",
    "save_regression",
    "segment_regressions",
    "segment_sources",
    "sensor_bias",
    "sensor_motion",
    "sensor_regression",
    "shapes_of",
    "simulate_torque",
    "static_poses",
    "tool_model",
    "with_shapes",
    "without_slip",
]
