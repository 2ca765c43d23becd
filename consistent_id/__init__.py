"""Dynamic parameters of robots, as a real body could have them."""

from consistent_id.friction import DriveTerms
from consistent_id.inertia import InertialParameters
from consistent_id.loaders import DHRow, from_modified_dh, load_urdf
from consistent_id.regressor import TorqueModel

__version__ = "0.1.0"

__all__ = [
    "DHRow",
    "DriveTerms",
    "InertialParameters",
    "TorqueModel",
    "from_modified_dh",
    "load_urdf",
]
