"""A person on force plates: 16 bodies from the base wrench alone.

``CONSISTENT_ID_DATASETS=... python benchmarks/force_plates.py`` takes some seconds.
The regressor is given [Lee2020]_; the published estimates are judged by their weighted
squared errors, and the one of least error among bodies within ellipsoids is proven.
The last line has the weight of the entropic distance at which the error is the
published one, and how far masses then are from the published estimate's.
"""

import os
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

import consistent_id as ci
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation.best_fit import BestFit, ScaledFit, best_fit
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit

PLACES = (0, 1, 2, 3, 4, 7, 5, 9, 8, 6)  # of our ten parameters among theirs
ROWS = ("nx", "ny", "fz")  # of the base wrench, that plates measure well
_EQUAL = 1e-7  # relative difference of errors that is none


class Person(NamedTuple):
    """The data, in this package's order of parameters."""

    rows: ci.regression.GivenRows
    regressor: np.ndarray
    measured: np.ndarray
    sigma: np.ndarray
    published: dict[str, np.ndarray]
    errors: dict[str, float]
    constraints: tuple[ci.PhysicalConsistency | ci.constraints.DensityOn, ...]

    def error(self, x: np.ndarray) -> float:
        """Weighted squared error of parameters, from all rows."""
        return float(self.squares(x).sum())

    def squares(self, x: np.ndarray) -> np.ndarray:
        """Return the same of each sample."""
        residual = (self.regressor @ x - self.measured) / self.sigma
        return np.asarray(np.sum(residual**2, axis=1))


def person(folder: Path) -> Person:
    """Read the data."""
    data = np.load(folder / "human_force_plates" / "regressor.npz")
    kinds = ("euclidean", "pullback", "entropic")
    nominal, *published = (
        data[f"phi_{kind}"].T[:, PLACES] for kind in ("prior", *kinds)
    )
    bodies = {f"body{k}": ci.InertialParameters(x) for k, x in enumerate(nominal)}
    A = data["A"].reshape(-1, len(ROWS), len(bodies), 10)[..., PLACES]
    A = A.reshape(*A.shape[:2], -1)
    b, sigma = data["b"].reshape(-1, len(ROWS)), data["sigma"]
    robot = ci.robot.free_bodies("person", bodies)
    shapes = (
        ci.constraints.DensityOn(name, ci.constraints.Ellipsoid.from_quadratic(Q))
        for name, Q in zip(bodies, data["ellipsoids"], strict=True)
    )
    return Person(
        rows=ci.regression.given_rows(robot, ROWS, A, b, sigma=sigma),
        regressor=A,
        measured=b,
        sigma=sigma,
        published={k: x.ravel() for k, x in zip(kinds, published, strict=True)},
        errors=dict(zip(kinds, data["ls_error"].tolist(), strict=True)),
        constraints=(ci.PhysicalConsistency(margin=0.0), *shapes),
    )


def least_error(data: Person) -> BestFit:
    """Return the best fit of bodies within their ellipsoids, certified."""
    model, regression, base = data.rows
    return best_fit(model, regression, data.constraints, base=base)


def at_error(
    data: Person, scaled: ScaledFit, error: float, weight: float
) -> PenalisedFit:
    """Return the compromise with the entropic distance that leaves an error, certified.

    By secants of log error over log weight, from a weight to start with; of `scaled`,
    see `least_error`.
    """
    distance = nominal_distance(data.rows.model, "entropic", scaled.unit)

    def excess(fit: PenalisedFit) -> float:
        return float(np.log(data.error(fit.solution.u * scaled.unit) / error))

    before, here = np.log(weight), np.log(weight) + 1e-3
    fit = penalised_fit(scaled, distance, weight)
    last = excess(fit)
    while True:
        start = fit.solution.u
        fit = penalised_fit(scaled, distance, float(np.exp(here)), start=start)
        value = excess(fit)
        if abs(value) <= _EQUAL:
            return fit
        before, here = here, here - value * (here - before) / (value - last)
        last = value


def main() -> None:
    data = person(Path(os.environ["CONSISTENT_ID_DATASETS"]))
    model, regression, base = data.rows
    clock = [process_time()]

    def seconds() -> str:
        clock.append(process_time())
        return f"{clock[-1] - clock[-2]:.2f} CPU s"

    plain = data.error(ci.least_squares(model, regression, base=base).parameters)
    print(f"rank {len(base)}; least squares {plain:.1f}, {seconds()}")
    for kind, x in data.published.items():
        print(f"{kind}: {data.error(x):.3f}, published {data.errors[kind]:.3f}")
    best = least_error(data)
    optimality = best.optimality
    print(
        f"bodies in ellipsoids: {best.misfit**2:.1f}, {optimality.verdict}, relative "
        f"gap {optimality.gap:.1e}, {seconds()}"
    )
    found = at_error(data, best.scaled, data.errors["entropic"], 3.7)
    x = found.solution.u * best.scaled.unit
    masses = x[::10] - data.published["entropic"].reshape(-1, 10)[:, 0]
    print(
        f"entropic at {data.error(x):.3f}: weight {found.weight:.4f}, "
        f"{found.optimality.verdict}, masses within {abs(masses).max():.1e} kg of the "
        f"published, {seconds()}"
    )


if __name__ == "__main__":
    main()
