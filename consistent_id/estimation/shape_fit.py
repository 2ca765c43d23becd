"""The shapes of friction that fit recordings best, and their intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.executors import Executor, single_threaded
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.shape_profile import (
    LeastMisfit,
    ShapeGroup,
    ShapeMisfit,
    ShapeProfile,
    allowed_rise,
    profile,
)
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.friction_shapes import (
    SHAPE_NAMES,
    shape_regression,
    shapes_of,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """Shapes of friction found by variable projection.

    Parameters
    ----------
    model : TorqueModel
        With the shapes found.
    profiles : tuple of ShapeProfile
        For each shape, or for each kind where joints share it: value, confidence
        interval, and the curve behind it.
    error_before, error_after : float
        ``||tau - prediction|| / ||tau||`` of least squares on these recordings, with
        the shapes of the model given and with those found.
    misfits : tuple of float
        Misfit that each start reached, relative to the best one, which is 1.
    correlation : float
        Samples that carry the information of one independent sample; see
        `correlation_length`.
    evaluations : int
        Shapes tried by the searches, without the profiles.
    seconds : float
    """

    model: TorqueModel
    profiles: tuple[ShapeProfile, ...]
    error_before: float
    error_after: float
    misfits: tuple[float, ...]
    correlation: float
    evaluations: int
    seconds: float

    def __getitem__(self, name: str) -> ShapeProfile:
        for found in self.profiles:
            if name in (found.name, *found.members):
                return found
        known = ", ".join(found.name for found in self.profiles)
        raise ProblemError(f"no shape {name!r} was fitted; fitted: {known}")


class _ShapeSearch(NamedTuple):
    log_values: Vector
    half_log: float
    evaluations: int


@single_threaded
def fit_shapes(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    kinds: Sequence[str] | None = None,
    shared: bool = True,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    weighted: bool = True,
    starts: int = 5,
    confidence: float = 0.95,
    seed: int = 0,
    base: BaseParameters | None = None,
) -> ShapeFit:
    """Find the shapes of friction by variable projection.

    The misfit of least squares, all linear parameters eliminated, is minimised over the
    logarithms of the shapes, from several starts.

    Parameters
    ----------
    model : TorqueModel
        Its shapes are the first start; shapes of other kinds stay fixed.
    recordings : Recording or sequence of Recording
        With velocity, acceleration and torque.
    kinds : sequence of str, optional
        Such as ``"velocity_scale"``, by default all; known kinds that the model does
        not have are ignored.
    shared : bool
        One value of each kind for all joints (turning and sliding ones apart), or one
        for each joint and coupling.
    bounds : mapping of str to (low, high), optional
        By kind; by default those of the terms.
    weighted : bool
        Whether joints are weighted by their noise at the shapes given.
    starts : int
        Starts in all; others than the first are drawn within the bounds.
    confidence : float
        Confidence of the intervals.
    seed : int
        Seed of the starts.
    base : BaseParameters, optional

    Raises
    ------
    ProblemError
        If there is no shape to fit, or bounds make no sense.
    NotExcitedError
        If the fit is exact.
    """
    begun = perf_counter()
    groups = _groups(model, kinds, shared)
    box = np.log([_bounds(group, bounds) for group in groups])
    base = base_parameters(model) if base is None else base
    data = shape_regression(model, several(recordings))
    before = data.regression(model)
    sigma = joint_noise(model, before, base=base) if weighted else before.sigma
    misfit = ShapeMisfit(data, base, groups, sigma)
    found = _searches(misfit, box, starts, seed)
    best = min(found, key=lambda search: search.half_log)
    final = misfit.at(best.log_values)
    residuals = data.residuals(final.parameters, data.columns(final.model))
    correlation = correlation_length(residuals, sigma)
    independent = data.samples * len(residuals) / correlation
    allowed = allowed_rise(independent, confidence)
    minimum = LeastMisfit(misfit.at, best.log_values, box, allowed)
    profiles = tuple(profile(minimum, g, i) for i, g in enumerate(groups))
    plain = ShapeMisfit(data, base, groups, np.ones(len(sigma)))
    return ShapeFit(
        model=final.model,
        profiles=profiles,
        error_before=_error(plain, np.log([g.value for g in groups])),
        error_after=_error(plain, best.log_values),
        misfits=tuple(float(np.exp(s.half_log - best.half_log)) for s in found),
        correlation=correlation,
        evaluations=sum(search.evaluations for search in found),
        seconds=perf_counter() - begun,
    )


def _groups(
    model: TorqueModel, kinds: Sequence[str] | None, shared: bool
) -> tuple[ShapeGroup, ...]:
    every = shapes_of(model)
    known = list(dict.fromkeys([*SHAPE_NAMES, *(shape.kind for shape in every)]))
    kinds = known if kinds is None else kinds
    unknown = sorted(set(kinds) - set(known))
    if unknown:
        raise ProblemError(f"shapes {unknown} are unknown; known: {', '.join(known)}")
    shapes = [shape for shape in every if shape.kind in kinds]
    if not shapes:
        raise ProblemError(
            f"the model's friction has no {' or '.join(kinds)}; choose a tanh Coulomb "
            "term, or Stribeck friction"
        )
    if not shared:
        return tuple(ShapeGroup(shape.name, (shape,)) for shape in shapes)
    together = sorted({(known.index(s.kind), s.kind, s.unit) for s in shapes})
    return tuple(
        ShapeGroup(
            f"{kind} of sliding joints" if unit == "m/s" else kind,
            tuple(s for s in shapes if (s.kind, s.unit) == (kind, unit)),
        )
        for _, kind, unit in together
    )


def _bounds(
    group: ShapeGroup, bounds: Mapping[str, tuple[float, float]] | None
) -> tuple[float, float]:
    low, high = (bounds or {}).get(group.kind, group.members[0].bounds)
    if not 0.0 < low < high < np.inf:
        raise ProblemError(
            f"bounds of {group.kind} are [{low}, {high}], expected 0 < low < high"
        )
    return low, high


def _searches(
    misfit: ShapeMisfit, box: Array, starts: int, seed: int
) -> list[_ShapeSearch]:
    """Search from the shapes given, and from others within the bounds."""
    if starts < 1:
        raise ProblemError(f"starts is {starts}, expected 1 or more")
    low, high = box.T
    first = np.clip(np.log([group.value for group in misfit.groups]), low, high)
    drawn = np.random.default_rng(seed).uniform(low, high, (starts - 1, len(first)))
    where = Executor.chosen(None) or Executor()
    return list(where.map(partial(_search, misfit, box), (first, *drawn)))


@single_threaded
def _search(misfit: ShapeMisfit, box: Array, start: Vector) -> _ShapeSearch:
    """Return the nearest minimum within the bounds."""
    from scipy.optimize import minimize

    def value(u: Vector) -> tuple[float, Vector]:
        found = misfit.at(u)
        return found.half_log, found.slope

    result = minimize(
        value,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=box,
        options={"ftol": 1e-14, "gtol": 1e-8, "maxiter": 200},
    )
    return _ShapeSearch(np.asarray(result.x), float(result.fun), int(result.nfev))


def _error(misfit: ShapeMisfit, log_values: Vector) -> float:
    """Return the relative error of unweighted least squares."""
    found = misfit.at(log_values)
    torque = found.regression.stacked()[:, -1]
    return float(np.exp(found.half_log) / np.linalg.norm(torque))
