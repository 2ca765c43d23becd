"""Instrumental variables: estimates that noise in the motion does not bias.

Noise in positions, differentiated twice, is in the regressor ``W`` as well as in the
residual of least squares, and biases the estimate towards zero.  Instruments ``Z`` are
the regressor along a motion without this noise: the commanded one, or that of a
simulated robot.  The solution of ``Z^T (W x - tau) = 0`` has no such bias [Janot2014]_.
With ``Z = Q R`` it reads ``Q^T W x = Q^T tau``, and no product of regressors is formed.

The test of Durbin, Wu and Hausman [Hausman1978]_ checks whether least squares and
instrumental variables differ by more than noise.  They do if instruments ``Z`` explain
a part of the residual of the regressor ``W``, so one regression contains both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
    parameter_origins,
)
from consistent_id.regression.correlated_noise import scores_along
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.linear import LinearSolution, column_sizes, solve_linear
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import build_regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

_STATIONARITY = 1e-9
_SAME = 1e-9  # share of the regressor by which instruments must differ from it
_RANK = 1e-9  # of unit columns, relative to the largest singular value


@single_threaded
def instrumental_variables(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    instruments: Recording | Sequence[Recording],
    *,
    base: BaseParameters | None = None,
) -> Estimate:
    """Estimate base parameters by instrumental variables.

    Each joint is weighted by its noise under weighted least squares.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
        As for `build_regression`: measured motion, prepared, and torque.
    instruments : Recording or sequence of Recording
        Motion with velocity and acceleration, sample for sample beside `recordings`,
        that is near the measured one and independent of its noise: the commanded
        motion, or that of a simulated robot under the same commands.
    base : BaseParameters, optional
        By default `base_parameters(model)`.

    Returns
    -------
    Estimate
        Its standard errors are for noise as correlated as the residuals.

    Raises
    ------
    RecordingError
        If instruments and recordings have other lengths.
    ProblemError
        If the instruments are the measured motion itself.
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    rows = instrumented(model, recordings, instruments, base)
    solution = solve_linear(rows.projected, rows.projected_torque)
    parameters = base.lift(solution.x)
    undetermined = open_combinations(solution, base.names)
    sigma = rows.sigma * np.sqrt(rows.misfit(solution.x) / rows.freedom)
    notes = list(base.near)
    if undetermined:
        notes.append(
            f"instruments and data determine {solution.rank} of {len(base)} base "
            "parameters; this is the smallest of all vectors that fit"
        )
    return Estimate(
        method=Method.INSTRUMENTAL_VARIABLES,
        model=model,
        base=base,
        parameters=parameters,
        base_covariance=_covariance(model, solution, rows, parameters, base),
        origins=parameter_origins(
            solution.row_space @ base.projection,
            np.zeros((0, len(model.layout))),
            elsewhere="convention",
        ),
        undetermined=undetermined,
        sigma=sigma,
        certificate=_certificate(rows, solution),
        notes=tuple(notes),
        seconds=perf_counter() - started,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Instrumented:
    """Instruments, regressor and torque of all samples, compressed.

    Parameters
    ----------
    factors : tuple of ndarray, shape (rows, 2 base + 1)
        Per joint, triangular factors of ``[Z, W, tau]``.
    sigma : ndarray, shape (torque joints,), [N m or N]
        Noise of each joint under weighted least squares.
    samples : int
        Rows behind the factors.
    correlation : float
        Samples that carry the information of one independent sample; see
        `correlation_length`.
    pairs : tuple of (Motion, Motion)
        Rows of each recording, and those of its instruments.
    """

    factors: tuple[Matrix, ...]
    sigma: Vector
    samples: int
    correlation: float
    pairs: tuple[tuple[Motion, Motion], ...]

    @property
    def base(self) -> int:
        """Number of base parameters."""
        return int(self.factors[0].shape[1] - 1) // 2

    @property
    def stacked(self) -> Matrix:
        """The factor of ``[Z, W, tau]`` of all joints, weighted."""
        pairs = zip(self.factors, self.sigma, strict=True)
        return triangle(np.asfortranarray(np.vstack([f / s for f, s in pairs])))

    @property
    def projected(self) -> Matrix:
        """``Q^T W``, shape (base, base)."""
        b = self.base
        return self.stacked[:b, b : 2 * b]

    @property
    def projected_torque(self) -> Vector:
        """``Q^T tau``, shape (base,)."""
        return np.asarray(self.stacked[: self.base, -1])

    @property
    def freedom(self) -> float:
        """Rows less base parameters."""
        return float(max(self.samples - self.base, 1))

    def misfit(self, x: Vector) -> float:
        """``||W x - tau||^2`` over all joints, weighted."""
        z = np.concatenate([np.zeros(self.base), x, [-1.0]])
        return float(np.sum((self.stacked @ z) ** 2))


def instrumented(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    instruments: Recording | Sequence[Recording],
    base: BaseParameters,
) -> Instrumented:
    """Compress instruments, regressor and torque together."""
    logs, beside = several(recordings), several(instruments)
    _require_pairs(logs, beside)
    regression = build_regression(model, logs)
    sigma = joint_noise(model, regression, base=base)
    x = base.lift(_weighted_solution(regression.weighted(sigma).stacked(), base))
    factors = [np.zeros((0, 2 * len(base) + 1)) for _ in model.torque_joints]
    lengths, samples, differs, pairs = [], 0, 0.0, list[tuple[Motion, Motion]]()
    for log, other in zip(logs, beside, strict=True):
        motion = motion_of(model, log, None)
        beside_it = _instruments_along(model, motion, other)
        pairs.append((motion, beside_it))
        start = 0
        for here in motion.pieces():
            there = beside_it.samples(start, start + len(here.q))
            start += len(here.q)
            W, Z = (
                rows.regressor(model)[:, list(base.independent)]
                for rows in (here, there)
            )
            differs = max(differs, float(abs(W - Z).max() / abs(W).max()))
            factors = _merged(factors, Z, W, here.torque.T)
        residual = motion.torque - motion.predicted(model, x)
        lengths.append(correlation_length(list(residual.T), sigma))
        samples += residual.size
    if differs < _SAME:
        raise ProblemError(
            "the instruments are the measured motion itself, noise included; give the "
            "commanded motion, or that of a simulated robot"
        )
    length = float(np.mean(lengths))
    return Instrumented(tuple(factors), sigma, samples, length, tuple(pairs))


def _weighted_solution(R: Matrix, base: BaseParameters) -> Vector:
    return solve_linear(R[:, list(base.independent)], R[:, -1]).x


def _merged(factors: list[Matrix], Z: Array, W: Array, tau: Array) -> list[Matrix]:
    """Add a chunk of samples to each joint's triangular factor."""
    return [
        triangle(
            np.asfortranarray(
                np.vstack([factor, np.column_stack([Z[j].T, W[j].T, tau[j]])])
            )
        )
        for j, factor in enumerate(factors)
    ]


def _instruments_along(model: TorqueModel, motion: Motion, other: Recording) -> Motion:
    """Return rows of instruments for the rows of a motion.

    They pass the same filter where instruments are there before it was cut; any others
    that do not depend on the noise are instruments as well, only weaker.
    """
    q, dq, ddq = _state(model, other)
    rows = motion.filtered
    if rows is None:
        return motion._replace(q=q, dq=dq, ddq=ddq)
    if len(q) == len(rows.along.q):
        along = rows.along._replace(q=q, dq=dq, ddq=ddq)
        return motion._replace(filtered=replace(rows, along=along))
    there = motion.places
    return motion._replace(filtered=None, q=q[there], dq=dq[there], ddq=ddq[there])


def _state(model: TorqueModel, motion: Recording) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of instruments."""
    motion = motion.of(model.robot.joint_names)
    if motion.velocity is None or motion.acceleration is None:
        raise RecordingError(
            f"{motion.name}, of instruments, has no velocity or no acceleration; "
            "sample the commanded path, or call signals.differentiated first"
        )
    return motion.position, motion.velocity, motion.acceleration


def _require_pairs(logs: Sequence[Recording], beside: Sequence[Recording]) -> None:
    if len(logs) != len(beside):
        raise RecordingError(
            f"{len(logs)} recordings, but {len(beside)} instruments; give one each"
        )
    for log, other in zip(logs, beside, strict=True):
        if len(log) != len(other):
            raise RecordingError(
                f"{log.name} has {len(log)} samples, its instruments {other.name} "
                f"{len(other)}; bring them to the same instants, as signals.aligned or "
                "signals.resampled do"
            )


def _covariance(
    model: TorqueModel,
    solution: LinearSolution,
    rows: Instrumented,
    x: Vector,
    base: BaseParameters,
) -> Matrix | None:
    """``(Z^T W)^-1 G (W^T Z)^-1`` at full rank.

    ``G`` is the covariance of the scores ``Z^T (tau - W x)``, from the spectrum of the
    residual; see `scores_along`.  With ``Z = Q R``, ``Z^T W = R^T Q^T W``.
    """
    if solution.null_space.shape[1]:
        return None
    R = rows.stacked[: rows.base, : rows.base]
    if abs(np.diag(R)).min() <= _RANK * abs(np.diag(R)).max():
        return None
    inverse = np.linalg.inv(R)
    residuals = [log.torque - log.predicted(model, x) for log, _ in rows.pairs]
    scores = scores_along(
        model,
        [beside for _, beside in rows.pairs],
        residuals,
        np.array(base.independent),
        [inverse / s for s in rows.sigma],
    )
    pairs = zip(scores, rows.sigma, strict=True)
    own = np.vstack([N / s**2 for N, s in pairs]) @ inverse
    G = own @ solution.pseudo_inverse.T
    return np.asarray(G.T @ G)


def _certificate(rows: Instrumented, solution: LinearSolution) -> Certificate:
    """Certify that the residual is orthogonal to the instruments."""
    left = rows.projected @ solution.x - rows.projected_torque
    size = np.linalg.norm(rows.projected_torque) or 1.0
    share = float(np.linalg.norm(left) / size)
    figures = {"orthogonality": share, "rank": float(solution.rank)}
    if share <= _STATIONARITY:
        reason = "the residual is orthogonal to all instruments"
        return Certificate("certified", reason, figures)
    reason = "the instruments do not excite all parameters that the data excite"
    return Certificate("uncertified", reason, figures)


@brief
@dataclass(frozen=True, slots=True)
class EndogeneityTest:
    """The result of `endogeneity_test`.

    Parameters
    ----------
    statistic : float
        ``F``: misfit that instruments explain, per direction, over the residual per
        effective sample.
    directions : int
        Number of directions in which instruments differ from the regressor.
    effective_samples : float
        Samples over their correlation length.
    p_value : float
        Probability of such an ``F`` by chance, if the motion's noise had no effect.
    """

    statistic: float
    directions: int
    effective_samples: float
    p_value: float

    def __str__(self) -> str:
        verdict = (
            "least squares and instrumental variables differ by more than noise"
            if self.p_value < 0.01
            else "least squares and instrumental variables agree within noise"
        )
        return (
            f"{verdict} (F = {self.statistic:.3g} of {self.directions} directions and "
            f"{self.effective_samples:.0f} effective samples, p = {self.p_value:.2g})"
        )


@single_threaded
def endogeneity_test(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    instruments: Recording | Sequence[Recording],
    *,
    base: BaseParameters | None = None,
) -> EndogeneityTest:
    """Test weighted least squares against instrumental variables.

    A small p-value shows that the regressor is correlated with the residual of least
    squares: by noise in the motion, a delay, or friction that the model lacks. Filter
    the noise, or use `instrumental_variables`.

    Parameters
    ----------
    model, recordings, instruments, base
        As for `instrumental_variables`.

    Raises
    ------
    ProblemError
        If there are too few effective samples.
    """
    from scipy.special import fdtrc

    base = base_parameters(model) if base is None else base
    rows = instrumented(model, recordings, instruments, base)
    R, b = rows.stacked, len(base)
    few, alone = _left(R[:, b : 2 * b], R[:, -1])
    rank, both = _left(R[:, : 2 * b], R[:, -1])
    directions = rank - few
    effective = rows.samples / rows.correlation
    freedom = effective - rank
    if directions < 1 or freedom < 1.0:
        raise ProblemError(
            f"{effective:.0f} effective samples and {directions} directions in which "
            "instruments differ from the motion are too few for a test; record longer"
        )
    statistic = ((alone - both) / directions) / (both / freedom)
    p = float(fdtrc(directions, freedom, statistic))
    return EndogeneityTest(float(statistic), directions, float(effective), p)


def _left(A: Matrix, b: Vector) -> tuple[int, float]:
    """Return the rank of columns, and the squared residual of a vector."""
    U, s, _ = svd(A / column_sizes(A), full_matrices=False)
    rank = int((s > _RANK * s[0]).sum())
    rest = b - U[:, :rank] @ (U[:, :rank].T @ b)
    return rank, float(rest @ rest)
