"""Mass, centre of mass and inertia of a load in a frame, with 95 % intervals.

Too wide an interval is a reason against the load.

Intervals are those of the least-squares estimate: its covariance, propagated to first
order through the change of frame, which is linear, and through

``c = h / m``,  ``I_c = I - (h.h 1 - h h^T) / m``.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id._support.tables import Table, brief
from consistent_id.estimation.determination import KNOWN
from consistent_id.estimation.payload import Payload
from consistent_id.estimation.verdict import Reason, percent
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import FixedFrame

QUANTITIES = ("m", "cx", "cy", "cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Mass, centre of mass, inertia about it: the order of `LoadQuantities`."""

UNITS = ("kg", *("m",) * 3, *("kg m^2",) * 6)
"""Their units."""

_ROWS, _COLUMNS = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
_COM, _INERTIA = slice(1, 4), slice(4, 10)
_TOUCHED = 1e-9  # entry of a map, relative to its largest, that is not rounding


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadQuantities:
    """A load's mass, centre of mass and inertia about it, in one frame.

    Parameters
    ----------
    frame : str
        Name of the frame.
    body : InertialParameters
        The physically consistent estimate, in this frame.
    low, high : array_like, shape (10,), [kg, m, kg m^2]
        Ends of 95 % intervals, in the order of `QUANTITIES`; infinite where the
        quantity is not identifiable.
    """

    frame: str
    body: InertialParameters
    low: Vector
    high: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self, {"low": (10,), "high": (10,)}, finite=False)

    @property
    def values(self) -> Vector:
        """Values of the consistent estimate, shape (10,); see `QUANTITIES`."""
        body = self.body
        return np.concatenate(
            [[body.mass], body.com, body.central_inertia[_ROWS, _COLUMNS]]
        )

    def table(self) -> Table:
        """Return the quantities with their intervals; "-" where not identifiable."""
        rows = tuple(
            (name, *_shown(value, low, high), unit)
            for name, value, low, high, unit in zip(
                QUANTITIES, self.values, self.low, self.high, UNITS, strict=True
            )
        )
        header = ("quantity", "value", "95 % from", "to", "unit")
        return Table(f"The load in the frame {self.frame}", header, rows)

    def to_dict(self) -> dict[str, object]:
        """Return values, intervals and units; None for an end that is infinite."""
        return {
            name: {
                "value": float(value),
                "low": float(low) if np.isfinite(low) else None,
                "high": float(high) if np.isfinite(high) else None,
                "unit": unit,
            }
            for name, value, low, high, unit in zip(
                QUANTITIES, self.values, self.low, self.high, UNITS, strict=True
            )
        }


def load_quantities(payload: Payload, frame: FixedFrame) -> LoadQuantities:
    """Return a load's quantities in a frame that is fixed to its carrier.

    Parameters
    ----------
    payload : Payload
        In the frame of the link that carries it.
    frame : FixedFrame
        Its place in that link.
    """
    change = _change(frame)
    free = change @ payload.free.vector
    errors = _errors(_slopes(free) @ change, payload.covariance)
    half = payload.quantile * errors
    centre = _central(free) if free[0] > 0.0 else np.full(10, np.nan)
    centre[0] = free[0]
    half = np.where(np.isfinite(centre), half, np.inf)
    centre = np.nan_to_num(centre)
    body = InertialParameters(change @ payload.body.vector)
    return LoadQuantities(frame.name, body, centre - half, centre + half)


def _shown(value: float, low: float, high: float) -> tuple[str, ...]:
    if not np.isfinite(high - low):
        return ("-",) * 3
    return f"{value:.4g}", f"{low:.4g}", f"{high:.4g}"


def inertia_width(payload: Payload) -> float:
    """Return how well the data show the inertia about the centre of mass.

    The width of the 95 % interval of its trace, over its value; infinite where it is
    not identifiable.
    """
    free = payload.free.vector
    if free[0] <= 0.0:
        return np.inf
    weights = np.zeros(10)
    weights[[4, 6, 9]] = 1.0
    slopes = weights @ _slopes(free)
    error = _errors(slopes[None, :], payload.covariance)[0]
    trace = float(weights @ _central(free))
    return float(2.0 * payload.quantile * error / trace) if trace > 0.0 else np.inf


def inertia_is_open(payload: Payload) -> bool:
    """Return whether a point mass may be nearer the truth than the estimated inertia.

    It may be if the 95 % interval of the trace reaches down to half of its value: after
    static poses, or if the load is too small for the motion.
    """
    return not inertia_width(payload) < 1.0


def _change(frame: FixedFrame) -> Matrix:
    """Return the matrix that takes parameters of the link to those of a frame."""
    rotation = frame.rotation.T
    translation = -rotation @ frame.translation
    columns = [
        InertialParameters(unit).transformed(rotation, translation).vector
        for unit in np.eye(10)
    ]
    return np.array(columns).T


def _central(vector: Vector) -> Vector:
    """Return the quantities of parameters; see `QUANTITIES`."""
    body = InertialParameters(vector)
    return np.concatenate(
        [[body.mass], body.com, body.central_inertia[_ROWS, _COLUMNS]]
    )


def _slopes(vector: Vector) -> Matrix:
    """Return the derivative of the quantities by the parameters, shape (10, 10)."""
    m, h = vector[0], vector[1:4]
    J = np.eye(10)
    if m <= 0.0:
        return J
    J[_COM, 0] = -h / m**2
    J[_COM, _COM] = np.eye(3) / m
    J[_INERTIA, 0] = _steiner(h, h) / (2.0 * m**2)
    for k, unit in enumerate(np.eye(3)):
        J[_INERTIA, 1 + k] = -_steiner(h, unit) / m
    return J


def _steiner(h: Vector, d: Vector) -> Vector:
    """Return the derivative of ``h.h 1 - h h^T`` along ``d``; six entries."""
    matrix = 2.0 * (h @ d) * np.eye(3) - np.outer(h, d) - np.outer(d, h)
    return np.asarray(matrix[_ROWS, _COLUMNS])


def _errors(rows: Matrix, covariance: Matrix) -> Vector:
    """Return the standard error of each row's functional, infinite if it is open."""
    unknown = ~np.isfinite(np.diag(covariance))
    known = np.where(unknown[:, None] | unknown[None, :], 0.0, covariance)
    squared = np.einsum("ij,jk,ik->i", rows, known, rows)
    size = abs(rows).max(axis=1, keepdims=True)
    touched = (abs(rows) > _TOUCHED * size)[:, unknown].any(axis=1)
    return np.where(touched, np.inf, np.sqrt(np.maximum(squared, 0.0)))


def reasons_of_mass(payload: Payload, known_mass: float | None) -> Iterator[Reason]:
    """Yield reasons against a mass: unknown, uncertain, or not that of a scale [kg]."""
    mass, half = payload.free.mass, payload.quantile * payload.standard_errors[0]
    if not np.isfinite(half):
        yield Reason(
            "mass not identifiable",
            "do not use",
            "the motion does not show the load's mass",
            "move joints that gravity loads, with the load and without it",
        )
        return
    seen = f"{mass:.3g} +- {half:.2g} kg (95 %)"
    if mass <= half:
        yield Reason(
            "no load is seen",
            "do not use",
            f"the mass is {seen}",
            "check that the log is the one with the load; record more motion of the "
            "joints that gravity loads",
        )
    elif known_mass is None and 2.0 * half > KNOWN * mass:
        yield Reason(
            "mass is uncertain",
            "use with care",
            f"the mass is {seen}: the interval is {percent(2.0 * half / mass)} wide",
            "record more motion of the joints that gravity loads, or weigh the load",
        )
    if known_mass is not None and abs(mass - known_mass) > half:
        yield Reason(
            "mass contradicts the scale",
            "do not use",
            f"the torques show {seen}, the scale {known_mass:.4g} kg",
            "check the gains that convert currents to torque, and that the logs differ "
            "by this load alone",
        )


def reasons_of_centre(quantities: LoadQuantities) -> Iterator[Reason]:
    """Yield a reason against a centre of mass that the motion does not show."""
    width = quantities.high[1:4] - quantities.low[1:4]
    unknown = [axis for axis, w in zip("xyz", width, strict=True) if not np.isfinite(w)]
    if unknown:
        yield Reason(
            "centre of mass not identifiable",
            "do not use",
            f"the motion does not show the centre of mass along {', '.join(unknown)} "
            f"of the frame {quantities.frame}",
            "move joints whose torque depends on it, with the load and without it",
        )


def reasons_of_inertia(payload: Payload) -> Iterator[Reason]:
    """Yield a reason for care if the inertia is open or uncertain."""
    advice = "accelerate the last joints quickly, with the load and without it"
    if inertia_is_open(payload):
        yield Reason(
            "inertia is open",
            "use with care",
            "the data do not show the inertia about the centre of mass within 50 %; "
            "controllers get a point mass",
            advice,
        )
    elif (width := inertia_width(payload)) > KNOWN:
        yield Reason(
            "inertia is uncertain",
            "use with care",
            f"the interval of the inertia's trace is {percent(width)} wide",
            advice,
        )
