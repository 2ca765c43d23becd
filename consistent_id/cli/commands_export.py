"""What ``consistent-id export`` does: a problem's estimate, in a format."""

from collections.abc import Mapping
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.c_source import to_c
from consistent_id.export.casadi_functions import casadi_file
from consistent_id.export.exported import Export
from consistent_id.export.mjcf import to_mjcf
from consistent_id.export.numpy_source import to_numpy
from consistent_id.export.pinocchio_model import pinocchio_file
from consistent_id.export.record import to_json
from consistent_id.export.urdf import to_urdf
from consistent_id.problems.problem import Problem

_WITHOUT_SOURCE = {
    "json": to_json,
    "pin": pinocchio_file,
    "numpy": to_numpy,
    "casadi": casadi_file,
    "c": to_c,
}


def exported(
    problem: Problem,
    estimate: Estimate,
    form: str,
    *,
    source: Path | None = None,
    allow_refused: bool = False,
) -> Export:
    """Return an estimate in a format.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
    form : {"urdf", "mjcf", "json", "pin", "numpy", "casadi", "c"}
    source : Path, optional
        File to put the estimate into, for URDF and MJCF; by default the problem's own
        model, if it is in that format; else the file is written from nothing.
    allow_refused : bool
    """
    files: Mapping[str, Path | None] = problem.model_files
    if form == "urdf":
        return to_urdf(estimate, source or files["urdf"], allow_refused=allow_refused)
    if form == "mjcf":
        return to_mjcf(estimate, source or files["mjcf"], allow_refused=allow_refused)
    if source is not None:
        raise ProblemError(f"a source is for URDF and MJCF, not for {form}")
    return _WITHOUT_SOURCE[form](estimate, allow_refused=allow_refused)
