"""The shapes of friction: numbers in which the torque is not linear.

Velocity scales, Stribeck velocities and exponents, by names such as
``"elbow.velocity_scale"``.  The regressions of the same recordings for many shapes cost
little: of a joint's rows ``[Y S(theta) tau]`` only ``S``, the columns of shaped
friction, depends on the shapes ``theta``.  With ``[Y tau] = Q R`` once and for all,

``[Y tau S] = [Q P] [[R, Q^T S], [0, U]]``, ``(1 - Q Q^T) S = P U``,

so that each ``theta`` costs two thin products and a narrow QR, exactly.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.drive_terms import LAWS
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import row_structure
from consistent_id.robot.parameters import did_you_mean

SHAPE_NAMES = tuple(dict.fromkeys(k for x in LAWS.values() for k in x.shape_parameters))
"""Shapes that known laws have."""


@dataclass(frozen=True, slots=True)
class FrictionShape:
    """One shape of a joint or of a coupling.

    Parameters
    ----------
    owner : str
        Joint, or label of a coupling.
    kind : str
        Such as ``"velocity_scale"``.
    bounds : tuple of (float, float)
        Where `fit_shapes` searches.
    """

    owner: str
    kind: str
    value: float
    unit: str
    bounds: tuple[float, float]

    @property
    def name(self) -> str:
        """Owner and kind, such as ``"elbow.velocity_scale"``."""
        return f"{self.owner}.{self.kind}"


def shapes_of(model: TorqueModel) -> tuple[FrictionShape, ...]:
    """Return the shapes of all joints that have a row, and of all couplings.

    Examples
    --------
    >>> from consistent_id import DHRow, DriveTerms, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0)])
    >>> drive = DriveTerms(coulomb="tanh", velocity_scale=0.02)
    >>> [(s.name, s.value) for s in shapes_of(TorqueModel(arm, drive))]
    [('joint1.velocity_scale', 0.02)]
    """
    robot = model.robot
    found: list[FrictionShape] = []
    for joint, terms in zip(robot.driven, model.terms, strict=True):
        if joint.name in model.torque_joints:
            slides = joint.kind == "prismatic"
            found += _shapes(joint.name, terms.terms, slides)
    for coupling, (first, _) in zip(model.couplings, model.coupled, strict=True):
        if {coupling.first, coupling.second} & set(model.torque_joints):
            slides = robot.driven[first].kind == "prismatic"
            found += _shapes(coupling.label, coupling.terms, slides)
    return tuple(found)


def with_shapes(model: TorqueModel, values: Mapping[str, float]) -> TorqueModel:
    """Return the model with the named shapes changed.

    Parameters
    ----------
    model : TorqueModel
    values : mapping of str to float
        By the names of `shapes_of`.

    Raises
    ------
    ProblemError
        If the model has no such shape, or a value is not positive.
    """
    known = {shape.name for shape in shapes_of(model)}
    for name in values:
        if name not in known:
            near = did_you_mean(name, sorted(known))
            raise ProblemError(f"the model has no shape {name!r}; {near}")
    changes: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        owner, kind = name.rsplit(".", 1)
        changes.setdefault(owner, {})[kind] = float(value)
    drive = tuple(
        terms.with_shapes(changes.get(joint, {}))
        for joint, terms in zip(model.robot.joint_names, model.terms, strict=True)
    )
    couplings = tuple(
        replace(coupling, **changes.get(coupling.label, {}))  # type: ignore[arg-type]
        for coupling in model.couplings
    )
    return replace(model, drive=drive, couplings=couplings)


def _shapes(
    owner: str, terms: Sequence[DriveTerm], slides: bool
) -> Iterable[FrictionShape]:
    """Return the shapes of terms, those that several share once."""
    found: dict[str, FrictionShape] = {}
    for term in terms:
        for kind, value in term.shapes.items():
            unit, low, high = term.shape_parameters[kind]
            found[kind] = FrictionShape(owner, kind, value, unit[slides], (low, high))
    return found.values()


@dataclass(frozen=True, slots=True, eq=False)
class _ShapedRows:
    """One joint's rows: what does not depend on shapes, and which columns do."""

    Q: Matrix  # (samples, fixed + 1)
    R: Matrix  # (fixed + 1, fixed + 1), torque last
    fixed: IntArray  # places of the columns in the layout
    shaped: IntArray
    kept: IntArray
    expand: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class ShapeRegression:
    """All that is needed to compress recordings for any shapes of friction.

    Memory grows with the samples: some forty numbers for each sample and joint.

    Parameters
    ----------
    rows : tuple
        Factors of each torque joint.
    motions : tuple of Motion
        Motions of the recordings.
    loads : tuple of dict of int to ndarray
        Torque transmitted in each motion by joints whose friction depends on it.
    """

    model: TorqueModel
    rows: tuple[_ShapedRows, ...]
    motions: tuple[Motion, ...]
    loads: tuple[dict[int, Vector], ...]

    @property
    def samples(self) -> int:
        """Number of rows of each joint."""
        return sum(len(motion.q) for motion in self.motions)

    def columns(self, model: TorqueModel) -> tuple[Matrix, ...]:
        """Return each torque joint's shaped columns, shape (samples, shaped)."""
        parts = [
            self._columns_along(model, motion, loads)
            for motion, loads in zip(self.motions, self.loads, strict=True)
        ]
        return tuple(np.concatenate(own) for own in zip(*parts, strict=True))

    def _columns_along(
        self, model: TorqueModel, motion: Motion, loads: dict[int, Vector]
    ) -> list[Matrix]:
        place = {
            (model.robot.joint_names.index(name), int(column)): (r, k)
            for r, (name, rows) in enumerate(
                zip(model.torque_joints, self.rows, strict=True)
            )
            for k, column in enumerate(rows.shaped)
        }
        along = motion.along
        out = [np.empty((len(along.q), len(rows.shaped))) for rows in self.rows]
        q, dq, ddq = map(np.ascontiguousarray, (along.q.T, along.dq.T, along.ddq.T))
        for joint, column, values in model.drive_entries(q, dq, ddq, loads):
            if (joint, column) in place:
                r, k = place[joint, column]
                out[r][:, k] = values
        found = [motion.through(own, row) for row, own in enumerate(out)]
        if motion.weights is None:
            return found
        weighted = zip(found, motion.weights.T, strict=True)
        return [own * weights[:, None] for own, weights in weighted]

    def regression(
        self, model: TorqueModel, columns: Sequence[Matrix] | None = None
    ) -> Regression:
        """Return the regression of a model that differs by its shapes alone.

        The same as `build_regression` gives, up to rounding.
        """
        columns = self.columns(model) if columns is None else columns
        factors = tuple(
            _factor(rows, S) for rows, S in zip(self.rows, columns, strict=True)
        )
        return Regression(
            layout=model.layout,
            joints=model.torque_joints,
            factors=factors,
            counts=tuple(np.sum([m.counts() for m in self.motions], axis=0).tolist()),
            fingerprint=model.fingerprint,
        )

    def residuals(self, x: Vector, columns: Sequence[Matrix]) -> tuple[Vector, ...]:
        """Return ``Y x - tau`` of each torque joint, sample by sample, [N m or N]."""
        residuals = []
        for rows, S in zip(self.rows, columns, strict=True):
            kept = rows.expand @ x
            of_fixed = np.isin(rows.kept, rows.fixed)
            z = np.append(kept[of_fixed], -1.0)
            residuals.append(rows.Q @ (rows.R @ z) + S @ kept[~of_fixed])
        return tuple(residuals)


def shape_regression(
    model: TorqueModel, recordings: Sequence[Recording]
) -> ShapeRegression:
    """Factorise what does not depend on shapes, once."""
    motions = [motion_of(model, recording, None) for recording in recordings]
    start = model.layout.inertial_size
    shaped = {i for i, term in enumerate(model.column_terms, start) if term.shapes}
    splits = [
        (kept, np.array([c not in shaped for c in kept], dtype=bool), expand)
        for kept, expand in row_structure(model)
    ]
    blocks = _blocks(model, motions, [kept[fixed] for kept, fixed, _ in splits])
    rows = []
    for block, (kept, fixed, expand) in zip(blocks, splits, strict=True):
        Q, R = np.linalg.qr(block)
        rows.append(_ShapedRows(Q, R, kept[fixed], kept[~fixed], kept, expand))
    loads = tuple(_loads(model, motion.along) for motion in motions)
    return ShapeRegression(model, tuple(rows), tuple(motions), loads)


def _blocks(
    model: TorqueModel, motions: Sequence[Motion], fixed: Sequence[IntArray]
) -> list[Matrix]:
    """Return ``[Y tau]`` of each torque joint's fixed columns."""
    samples = sum(len(m.torque) for m in motions)
    blocks = [np.empty((samples, len(columns) + 1)) for columns in fixed]
    start = 0
    for motion in motions:
        for part, rows in motion.rows(model, fixed):
            for block, own in zip(blocks, rows, strict=True):
                block[start + part.start : start + part.stop] = own
        start += len(motion.torque)
    return blocks


def _loads(model: TorqueModel, along: Motion) -> dict[int, Vector]:
    """Return the torque of joints whose friction depends on it, [N m or N]."""
    references, row = model.load_references, model.rows
    if not references:
        return {}
    bodies = next(iter(references.values()))  # of one robot for all joints
    torque = model.rigid_torque(bodies, (along.q, along.dq, along.ddq))
    return {j: torque[:, row[j]] for j in references}


def _factor(rows: _ShapedRows, S: Matrix) -> Matrix:
    """Return a joint's factor over all parameters and the torque."""
    T = rows.Q.T @ S
    rest = S - rows.Q @ T
    again = rows.Q.T @ rest  # once more, for orthogonality to rounding
    rest -= rows.Q @ again
    U = triangle(np.asfortranarray(rest))
    fixed, shaped = len(rows.fixed), len(rows.shaped)
    kept = np.zeros((fixed + 1 + len(U), fixed + shaped))
    of_fixed = np.isin(rows.kept, rows.fixed)
    kept[: fixed + 1, of_fixed] = rows.R[:, :-1]
    kept[: fixed + 1, ~of_fixed] = T + again
    kept[fixed + 1 :, ~of_fixed] = U
    torque = np.append(rows.R[:, -1], np.zeros(len(U)))
    return np.column_stack([kept @ rows.expand, torque])
