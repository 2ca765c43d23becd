"""Robot models from the forms in which people keep them."""

from consistent_id.loaders._urdf_lint import lint_urdf
from consistent_id.loaders.dh import DHRow, from_classical_dh, from_modified_dh
from consistent_id.loaders.findings import Finding
from consistent_id.loaders.mjcf import load_mjcf
from consistent_id.loaders.urdf import load_urdf

__all__ = [
    "DHRow",
    "Finding",
    "from_classical_dh",
    "from_modified_dh",
    "lint_urdf",
    "load_mjcf",
    "load_urdf",
]
