"""How flat the misfit is around a shape: its profile, and a confidence interval."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from consistent_id._support.arrays import Array, Vector, freeze_arrays
from consistent_id.estimation.shapes.shape_misfit import Misfit, ShapeGroup

_FIRST = 0.05  # first step of a profile, in the logarithm of the shape
_BEYOND = 2.0  # profiles are followed until this many times the interval's half width
_MOST = 40  # steps on either side


@dataclass(frozen=True, slots=True, eq=False)
class ShapeProfile:
    """One shape: its value, its interval, and the curve of the least misfit.

    Parameters
    ----------
    members : tuple of str
        Shapes that have this value.
    low, high : float
        Confidence interval, or the bounds of the search where it reaches them.
    curve : array_like, shape (points, 2)
        Values, and the misfit there relative to the best, all else fitted anew.
    low_found, high_found : bool
        Whether the interval ends before the bound of the search.
    """

    name: str
    members: tuple[str, ...]
    value: float
    low: float
    high: float
    unit: str
    curve: Array
    low_found: bool
    high_found: bool

    def __post_init__(self) -> None:
        freeze_arrays(self, {"curve": (None, 2)})

    @property
    def determined(self) -> bool:
        """Whether the data bound the shape on both sides."""
        return self.low_found and self.high_found

    def __str__(self) -> str:
        text = f"{self.name} = {self.value:.3g} {self.unit}"
        if self.determined:
            return f"{text} [{self.low:.3g}, {self.high:.3g}]"
        open_side = "at least" if self.low_found else "at most"
        if not (self.low_found or self.high_found):
            return f"{text}, which the data do not determine"
        limit = self.low if self.low_found else self.high
        return f"{text}, by the data {open_side} {limit:.3g}"


def profile(
    misfit: Callable[[Vector], Misfit],
    group: ShapeGroup,
    place: int,
    best: Vector,
    box: Array,
    *,
    independent: float,
    confidence: float,
) -> ShapeProfile:
    """Follow the least misfit as one shape moves away from the best.

    The interval holds the shapes whose sum of squares is below ``exp(chi2 / N)`` of the
    least, with the chi-square quantile of one degree of freedom and `independent`
    samples ``N``; its ends are interpolated in the root of the logarithm, which is
    straight for a quadratic.
    """
    from scipy.special import chdtri

    allowed = chdtri(1, 1.0 - confidence) / independent / 2.0  # of half the logarithm
    least = misfit(best).half_log
    points = [(best[place], 0.0)]
    for side in (-1.0, 1.0):
        end = box[place][int(side > 0)]
        step, u, others = _FIRST, best[place], best
        for _ in range(_MOST):
            u = np.clip(u + side * step, *box[place])
            others, found = _least_at(misfit, place, u, others, box)
            rise = max(found - least, 0.0) / allowed
            points.append((u, side * np.sqrt(rise)))
            if u == end or rise > _BEYOND**2:
                break
            # Steps grow as long as little happens, and shrink where much does.
            last = abs(points[-1][1] - (points[-2][1] if len(points) > 2 else 0.0))
            step *= 2.0 if last < 0.25 else 0.5 if last > 1.0 else 1.0
    ordered = np.array(sorted(points))
    low, low_found = _crossing(ordered[ordered[:, 1] <= 0.0][::-1], -1.0)
    high, high_found = _crossing(ordered[ordered[:, 1] >= 0.0], 1.0)
    relative = np.exp(ordered[:, 1] ** 2 * allowed)
    return ShapeProfile(
        name=group.name,
        members=tuple(shape.name for shape in group.members),
        value=float(np.exp(best[place])),
        low=float(np.exp(low)),
        high=float(np.exp(high)),
        unit=group.unit,
        curve=np.column_stack([np.exp(ordered[:, 0]), relative]),
        low_found=low_found,
        high_found=high_found,
    )


def _least_at(
    misfit: Callable[[Vector], Misfit], place: int, u: float, start: Vector, box: Array
) -> tuple[Vector, float]:
    """Return the least misfit with one shape fixed."""
    fixed = np.array(start)
    fixed[place] = u
    free = [i for i in range(len(start)) if i != place]
    if not free:
        return fixed, misfit(fixed).half_log
    from scipy.optimize import minimize

    def value(v: Vector) -> tuple[float, Vector]:
        full = fixed.copy()
        full[free] = v
        found = misfit(full)
        return found.half_log, found.slope[free]

    options = {"ftol": 1e-10, "gtol": 1e-6, "maxiter": 30}
    result = minimize(
        value,
        fixed[free],
        jac=True,
        method="L-BFGS-B",
        bounds=box[free],
        options=options,
    )
    fixed[free] = result.x
    return fixed, float(result.fun)


def _crossing(side: Array, level: float) -> tuple[float, bool]:
    """Return where a side of the profile, from the best outwards, reaches a level."""
    for near, far in pairwise(side):
        if abs(far[1]) >= 1.0:
            share = (level - near[1]) / (far[1] - near[1])
            return float(near[0] + share * (far[0] - near[0])), True
    return float(side[-1][0]), False
