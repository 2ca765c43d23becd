"""The structure of a model's rows, as random motions show it.

Ranks, columns that depend on others, and how much torque a parameter makes are the same
for rows and for their triangular factor.  So the rows of random motions are compressed
once for each model, of each row the columns that it has, and kept.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import STRUCTURAL_TOLERANCE, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout

_PROBES = 16  # states that show which columns a row has


class RowModel(Protocol):
    """Rows of measurements, ``y = Y(q, dq, ddq) x``, such as a `TorqueModel`'s.

    Attributes
    ----------
    robot : RobotModel
        The robot whose joints move.
    terms : tuple of DriveTerms
        Drive terms of each of its joints.
    layout : ParameterLayout
        Layout of ``x``.
    torque_joints : tuple of str
        Names of the rows.
    fingerprint : str
        Equal for models whose rows can be combined.
    """

    def __hash__(self) -> int:
        """Return the hash; a `RowModel` is a value that never changes."""

    @property
    def robot(self) -> RobotModel:
        """The robot whose joints move."""

    @property
    def terms(self) -> tuple[DriveTerms, ...]:
        """Drive terms of each of its joints."""

    @property
    def layout(self) -> ParameterLayout:
        """Layout of the parameters."""

    @property
    def torque_joints(self) -> tuple[str, ...]:
        """Names of the rows."""

    @property
    def fingerprint(self) -> str:
        """Equal for models whose rows can be combined."""

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        base: BaseMotion | None = None,
    ) -> Array:
        """Return ``Y``, shape (rows, parameters, samples)."""

    def chunks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = ...,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Array]]:
        """Yield ``(samples, Y)`` piece by piece."""

    def kept_chunks(
        self,
        kept: Sequence[IntArray],
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = ...,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` of some columns, piece by piece."""


class NoisyRows(Protocol):
    """Rows along one recording, such as a `Motion`."""

    @property
    def q(self) -> Matrix:
        """Positions, shape (rows, joints)."""

    @property
    def dq(self) -> Matrix:
        """Velocities, shape (rows, joints)."""

    @property
    def mixed(self) -> bool:
        """See `Motion.mixed`."""

    def samples(self, start: int, stop: int) -> "NoisyRows":
        """Return consecutive rows."""

    def counts(self) -> IntArray:
        """See `Motion.counts`."""

    def noise_lost(self) -> Vector:
        """See `Motion.noise_lost`."""

    def rows(
        self, model: TorqueModel, kept: Sequence[IntArray]
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """See `Motion.rows`."""

    def shifted(self, row: int) -> Array | None:
        """See `Motion.shifted`."""

    def drive_columns(self, terms: DriveTerms, joint: int, row: int) -> Matrix:
        """See `Motion.drive_columns`."""


class RandomStates(NamedTuple):
    """Random states of joints, shape (samples, joints), and of a floating base."""

    q: Matrix
    dq: Matrix
    ddq: Matrix
    base: BaseMotion | None


def random_states(
    model: RowModel, *, seed: int = 0, samples: int | None = None
) -> RandomStates:
    """Return the states of `random_regressor`, or another number of them."""
    rng = np.random.default_rng(seed)
    n = len(model.robot)
    samples = 3 * len(model.layout) if samples is None else samples
    q = rng.uniform(-np.pi, np.pi, (samples, n))
    dq, ddq = rng.uniform(-2.0, 2.0, (2, samples, n))
    dq[::2] *= [_slow(terms) for terms in model.terms]
    base = _random_base(model, samples, rng) if model.robot.floating else None
    return RandomStates(q, dq, ddq, base)


def random_regressor(model: RowModel, *, seed: int = 0) -> Array:
    """Return the regressor of random states, (torque joints, parameters, samples).

    There are three times as many samples as there are parameters.  Every other one is
    slow for joints whose friction at rest fades: at full speed nothing is left of it.
    """
    states = random_states(model, seed=seed)
    return model.regressor(states.q, states.dq, states.ddq, base=states.base)


def _random_base(model: RowModel, samples: int, rng: np.random.Generator) -> BaseMotion:
    """Return random motion of a base, in all directions of gravity."""
    w, dw, a = rng.uniform(-2.0, 2.0, (3, samples, 3))
    R, _ = np.linalg.qr(rng.normal(size=(samples, 3, 3)))
    R *= np.linalg.det(R)[:, None, None]
    down = np.swapaxes(R, 1, 2) @ model.robot.gravity
    return BaseMotion(w, dw, a - down, R)


def _slow(terms: DriveTerms) -> float:
    """Return the factor of a joint's random velocity at which fading friction shows."""
    fading = (term.fading_velocity for term in terms.terms)
    return min((v for v in fading if v is not None), default=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class RandomRows:
    """The rows of random motions, each compressed.

    Parameters
    ----------
    width : int
        Parameters.
    samples : int
    columns : tuple of ndarray of int
        Columns of each row that are not zero for every motion.
    factors : tuple of ndarray
        Triangular, of these columns.
    """

    width: int
    samples: int
    columns: tuple[IntArray, ...]
    factors: tuple[Matrix, ...]

    def dense(self, row: int) -> Matrix:
        """Return a row's factor with all columns."""
        whole = np.zeros((len(self.factors[row]), self.width))
        whole[:, self.columns[row]] = self.factors[row]
        return whole

    def stacked(self) -> Matrix:
        """Return the triangular factor of all rows together."""
        rows = [self.dense(row) for row in range(len(self.factors))]
        return triangle(np.asfortranarray(np.vstack(rows)))

    @property
    def norms(self) -> Vector:
        """Norm of each column over all rows and samples, shape (parameters,)."""
        squares = np.zeros(self.width)
        for columns, factor in zip(self.columns, self.factors, strict=True):
            squares[columns] += np.sum(factor**2, axis=0)
        return np.asarray(np.sqrt(squares))

    def rms(self, x: Vector) -> Vector:
        """Return the root-mean-square torque that parameters make in each row."""
        pairs = zip(self.columns, self.factors, strict=True)
        norms = [np.linalg.norm(factor @ x[columns]) for columns, factor in pairs]
        return np.asarray(np.array(norms) / np.sqrt(self.samples))


@lru_cache(maxsize=16)
@single_threaded
def random_rows(model: RowModel, *, seed: int = 0) -> RandomRows:
    """Return the compressed rows of `random_regressor`."""
    probes = random_states(model, seed=seed, samples=_PROBES)
    shown = model.regressor(probes.q, probes.dq, probes.ddq, base=probes.base)
    columns = tuple(np.flatnonzero(row.any(axis=1)) for row in shown)
    states = random_states(model, seed=seed)
    samples = len(states.q)
    moved = states.q, states.dq, states.ddq
    ((_, blocks),) = model.kept_chunks(columns, *moved, samples, base=states.base)
    factors = tuple(triangle(block[:, :-1]) for block in blocks)
    return RandomRows(len(model.layout), samples, columns, factors)


@lru_cache(maxsize=16)
def row_structure(
    model: TorqueModel, *, mixed: bool = False
) -> tuple[tuple[IntArray, Matrix], ...]:
    """Return, per joint, its row's independent columns and how they give all others.

    A row of joint ``j`` is zero beyond its descendants, and of the rest about half are
    combinations of others for every motion; only independent columns are factorised,
    chosen by pivoting so that the others follow without loss of digits.

    Parameters
    ----------
    mixed : bool
        Whether rows hold parts of all others, see `ContactMixing`.
    """
    p, inertial = len(model.layout), model.layout.inertial_size
    structure: list[tuple[IntArray, Matrix]] = []
    found, count = random_rows(model), len(model.torque_joints)
    rows = [found.stacked()] if mixed else [found.dense(row) for row in range(count)]
    for row in rows:
        kept, K = _pivoted_columns(row[:, :inertial])
        drive = [i for i in range(inertial, p) if row[:, i].any()]
        expand = np.zeros((len(kept) + len(drive), p))
        expand[: len(kept), :inertial] = K
        expand[range(len(kept), len(expand)), drive] = 1.0
        structure.append((np.array([*kept, *drive], dtype=np.intp), expand))
    return tuple(structure * count if mixed else structure)


def joint_rows(
    model: TorqueModel, motion: NoisyRows
) -> Iterator[tuple[Matrix, Matrix]]:
    """Yield each joint's rows with torque, and how all parameters act on them.

    Rows have the columns that are kept of the joint; times ``expand @ x``, they are the
    torque of parameters ``x``.
    """
    structure = row_structure(model, mixed=motion.mixed)
    columns = [kept for kept, _ in structure]
    n = len(motion.q)
    of_joints = [np.empty((n, len(kept) + 1), order="F") for kept in columns]
    for part, blocks in motion.rows(model, columns):
        for rows, block in zip(of_joints, blocks, strict=True):
            rows[part] = block
    for rows, (_, expand) in zip(of_joints, structure, strict=True):
        yield rows, expand


def _pivoted_columns(W: Matrix) -> tuple[list[int], Matrix]:
    """Return independent columns and the map ``K`` with ``W = W[:, kept] K``."""
    from scipy.linalg import qr, solve_triangular

    norms = np.linalg.norm(W, axis=0)
    if not norms.any():
        return [], np.zeros((0, W.shape[1]))
    unit = np.where(norms > 0.0, norms, 1.0)
    R, order = qr(W / unit, mode="r", pivoting=True)
    size = abs(np.diag(R))
    rank = int((size > STRUCTURAL_TOLERANCE * size[0]).sum())
    kept = order[:rank]
    K = np.zeros((rank, W.shape[1]))
    K[:, order] = solve_triangular(R[:rank, :rank], R[:rank])
    K = K * unit / unit[kept, None]
    K[:, kept] = np.eye(rank)
    return kept.tolist(), K
