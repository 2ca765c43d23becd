"""What is said of a draft: comments of its problem file, and a table for people."""

from typing import TYPE_CHECKING

from consistent_id._support.tables import Table

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft

DRIVE_COMMENTS = {
    "drive": "GUESS: viscous friction, Coulomb friction, a constant offset.\n"
    "rotor_inertia = true adds the rotors of geared motors.",
    "drive.velocity_scale": "GUESS [rad/s or m/s]: width of the sign change",
}
"""Of a drive of which nothing is known."""

_GAINS_COMMENTS = {
    "data.gains": "GUESS: the delay [s] with which the torque fits best, one\n"
    "sample at the most; consistent-id rollout --choose finds a better one.",
    "data.gains.delay": "",
}


def comments_of(draft: "Draft") -> dict[str, str]:
    """Return the comments of a draft's problem file, by key."""
    comments = {
        "model": f"{_held_sentence(draft)}Joints: {', '.join(draft.joints)}.",
        **DRIVE_COMMENTS,
        **_of_constraints(draft),
        "data": _of_roles(draft),
        **_of_columns(draft),
        **_GAINS_COMMENTS,
        **_of_preparation(draft),
    }
    if draft.standing is not None:
        comments |= draft.standing.comments
    if draft.selection is None:
        return comments
    if draft.selection.choice.masses != draft.masses:
        del comments["constraints.masses"]
    del comments["drive.velocity_scale"]
    chosen = draft.selection.comments()
    chosen["data.preparation"] = f"{_rate(draft)}\n{chosen['data.preparation']}"
    return comments | chosen


def _of_constraints(draft: "Draft") -> dict[str, str]:
    if draft.bodies == "model":
        stated, masses = "bodies", ""
    elif draft.masses == "datasheet":
        stated, masses = "masses", '"free" if they are made up'
    else:
        stated, masses = "masses", "known ones make estimates better"
    known = f"GUESS: the {stated} of {draft.model.name} are those of the robot."
    return {
        "constraints": known if draft.masses == "datasheet" else "",
        "constraints.masses": masses,
    }


def _of_roles(draft: "Draft") -> str:
    """Say how one log is divided, if it is for both, training and validation."""
    if len({entry.log for entry in draft.recordings}) == len(draft.recordings):
        return ""
    return "The first 70 % of the motion are for training, the rest for validation."


def _of_columns(draft: "Draft") -> dict[str, str]:
    rest = "units are rad, m, N m and N, as no name contradicts this"
    notes = (*draft.notes, f"other {rest}" if draft.columns.units else rest)
    return {
        "data.columns": "\n".join(f"GUESS: {note}." for note in notes),
        "data.columns.time": "",
        "data.columns.position": "",
    }


def _of_preparation(draft: "Draft") -> dict[str, str]:
    return {
        "data.preparation": f"{_rate(draft)}\nGUESS: {draft.cutoff_reason}.",
        "data.preparation.max_gap": "s; longest step between samples",
        "data.preparation.resample": "Hz; the time stamps jitter",
        "data.preparation.motion_cutoff": "Hz",
        "data.preparation.torque_cutoff": "Hz",
    }


def _rate(draft: "Draft") -> str:
    return f"The log has {draft.rate:.6g} samples a second."


def _held_sentence(draft: "Draft") -> str:
    """Say which joints do not move, if there are such."""
    where, joints = _held(draft)
    return f"{where.capitalize()}: {joints}.\n" if draft.held else ""


def _held(draft: "Draft") -> tuple[str, str]:
    """Say which joints are held, and where if not at zero."""
    if not any(draft.held.values()):
        return "locked at zero", ", ".join(draft.held)
    return "locked", ", ".join(f"{k} at {v:g}" for k, v in draft.held.items())


def draft_table(draft: "Draft") -> Table:
    """Return what was taken from the files, and what was guessed."""
    columns = draft.columns
    channels = ("time", "position", "velocity", "torque", "position_command")
    named = ((c, getattr(columns, c)) for c in channels)
    units = ", ".join(f"{channel}: {u}" for channel, u in columns.units.items())
    rows = [
        ("joints", ", ".join(draft.joints)),
        ("columns", ", ".join(f"{c}: {name}" for c, name in named if name is not None)),
        ("rate", f"{draft.rate:.6g} Hz" + ("; resampled" if draft.resample else "")),
        ("units", units or "s, rad, m, N m, N"),
        *(
            (f"rows of {entry.log.name}", f"{a} to {b} for {entry.role}")
            for entry in draft.recordings
            for a, b in (entry.rows,)
        ),
        ("cut-off", f"{draft.cutoff:g} Hz: {draft.cutoff_reason}"),
        _taken(draft),
        ("friction", "viscous, Coulomb (tanh), offset"),
    ]
    if draft.selection is not None:
        # The table of the selection has them.
        del rows[-3 if draft.bodies == "identified" else -1 :]
    if draft.held:
        rows.insert(1, _held(draft))
    return Table(
        f"How {draft.model.name} and {draft.log_names} were read",
        ("what", "which"),
        tuple(rows),
        (*draft.notes, "consistent-id init writes this down, to be corrected"),
    )


def _taken(draft: "Draft") -> tuple[str, str]:
    """Say what is taken from the model."""
    if draft.bodies == "model":
        return "bodies", "the model's"
    if draft.standing is not None:
        return "bodies", "the model's, but for that of the base, which is free"
    return "masses", "the model's" if draft.masses == "datasheet" else "free"
