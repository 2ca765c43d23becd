"""Section: observed and identified friction over velocity."""

import numpy as np

from consistent_id._support.arrays import Array, IntArray
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.report.markup import folded, grid, joined, paragraphs, tag
from consistent_id.report.plot import Frame, dots, plot, spanning
from consistent_id.report.report_content import (
    ReportContent,
    Section,
    angle_unit,
    torque_unit,
)

_DOTS = 500


def friction_section(content: ReportContent) -> Section | None:
    """Return a friction curve for each joint; None without friction or recordings."""
    model, estimate = content.model, content.main.estimate
    columns = friction_columns(model)
    recordings = content.training or content.validation
    if not len(columns) or not recordings:
        return None
    found = [observed_friction(estimate, r, columns) for r in recordings]
    seen, said, dq = (np.concatenate(parts) for parts in zip(*found, strict=True))
    panels = []
    for j, (_, joint) in enumerate(content.joint_rows):
        thin = slice(None, None, max(1, len(seen) // _DOTS))
        x, y, f = dq[thin, j], seen[thin, j], said[thin, j]
        frame = Frame(spanning([x]), spanning([y, f]), height=200)
        panels.append(
            plot(
                frame,
                dots(frame, x, y, "measured"),
                dots(frame, x, f, "main fine"),
                across=f"velocity [{angle_unit(joint)}/s]",
                down=f"friction [{torque_unit(joint)}]",
                title=joint.name,
            )
        )
    lead = paragraphs(
        "The coloured curve is the identified friction, offsets included. Grey dots "
        "are the measured torque minus all that is not friction. Friction that depends "
        "on the load or on another joint's rate is not a single curve."
    )
    rows = [
        (estimate.model.layout.names[i], f"{estimate.parameters[i]:.4g}", unit)
        for i, unit in zip(columns, _units(model, columns), strict=True)
    ]
    body = joined(
        (
            lead,
            tag("div", *panels, class_="panels"),
            folded("Coefficients", grid(("coefficient", "value", "unit"), rows)),
        )
    )
    return Section("friction", "Friction", body)


def friction_columns(model: TorqueModel) -> IntArray:
    """Return the indices of the parameters of friction and offsets."""
    start = model.layout.inertial_size
    places = [i for i, t in enumerate(model.column_terms, start) if t.friction]
    return np.array(places, dtype=np.intp)


def observed_friction(
    estimate: Estimate, recording: Recording, columns: IntArray
) -> tuple[Array, Array, Array]:
    """Return observed and identified friction, and the joints' rates.

    Observed is ``tau - Y x + Y_f x_f``, with ``f`` the friction's columns.  All of
    shape (samples, joints with torque).
    """
    model = estimate.model
    motion = motion_of(model, recording, None)
    alone = np.zeros_like(estimate.parameters)
    alone[columns] = estimate.parameters[columns]
    state = motion.q, motion.dq, motion.ddq
    identified = model.predict(alone, *state, base=motion.base)
    rest = motion.torque - estimate.predict(recording)
    of_joints = {name: k for k, name in enumerate(model.robot.joint_names)}
    rows = [c for c, j in enumerate(model.torque_joints) if j in of_joints]
    joints = [of_joints[model.torque_joints[c]] for c in rows]
    seen = rest + identified
    return seen[:, rows], identified[:, rows], motion.dq[:, joints]


def _units(model: TorqueModel, columns: IntArray) -> list[str]:
    return [model.layout.units[i] for i in columns]
