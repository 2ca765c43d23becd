"""Friction in the form that a file format, or a simulator, has.

An export leaves other terms out, and their friction is then missing.  If friction is
fitted again without these terms, the remaining terms compensate for them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec

from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.regression.drive.drive_terms import DEFAULTS

_EVERYWHERE = ("viscous", "coulomb", "velocity_scale", "offset", "rotor_inertia")

TERMS: Mapping[str, tuple[str, ...]] = {
    "mjcf": (*_EVERYWHERE, "spring", "friction_slope"),
    "mjlab": (*_EVERYWHERE, "spring", "friction_slope"),
    "isaaclab": _EVERYWHERE,
    "urdf": _EVERYWHERE,
}
"""Drive terms that are fitted for a format.  An offset is fitted for all: without it
friction would compensate for it; an export of a format without it has a note.
"""


def in_form_of(problem: Problem, form: str) -> Problem:
    """Return the problem without drive terms that a format lacks.

    Asymmetric friction becomes Coulomb friction and an offset.

    Parameters
    ----------
    form : str
        One of `TERMS`.

    Raises
    ------
    ProblemError
        If the format is not known.
    """
    if form not in TERMS:
        known = ", ".join(TERMS)
        raise ProblemError(f"no form of friction {form!r}, expected one of {known}")
    changed = table_in_form_of(problem.table, form)
    made = problem_of(changed, problem.source or problem.folder / "problem.toml")
    made._read.update(problem._read)
    return replace(made, source=problem.source)


def table_in_form_of(table: ProblemTable, form: str) -> ProblemTable:
    """Return a problem's table without drive terms that a format of `TERMS` lacks.

    Asymmetric friction becomes Coulomb friction and an offset.
    """
    change = msgspec.structs.replace
    lacking = [name for name in DEFAULTS if name not in TERMS[form]]

    def reduced(drive: Any) -> Any:
        stated = {
            name: DEFAULTS[name]
            for name in lacking
            if getattr(drive, name) is not msgspec.UNSET
        }
        if getattr(drive, "asymmetric") is True:  # noqa: B009  fields made by msgspec
            stated["offset"] = True
        return change(drive, **stated)

    return change(
        table,
        drive=reduced(table.drive),
        joints={name: reduced(joint) for name, joint in table.joints.items()},
    )
