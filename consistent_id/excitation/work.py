"""Work of a search: counted by computations and not by the clock.

A search on a busy machine takes longer and gives the same result.  The unit is a
second of an idle processor of 2023, on which the constants below were measured
(``python benchmarks/excitation_work.py``); on another one a unit takes more or less
than a second.
"""

from dataclasses import dataclass

_ENTRY = 1.2e-7  # s per entry of the base regressor, for an objective and its gradient
_VALUE = 0.3  # of that, without the gradient
_STEP = 1.8e-3  # s per iteration of IPOPT
_NONZERO = 2.8e-7  # s per nonzero of the linear rows and iteration
_SHAPE = 2.5e-7  # s per sample and joint, for measuring the linear limits


@dataclass(frozen=True, slots=True)
class Costs:
    """Work of the repeated parts of a search, in units.

    Parameters
    ----------
    gradient : float
        An objective with its gradient.
    value : float
        An objective alone.
    iteration : float
        A step of the solver, with the linear limits.
    measure : float
        Measuring all guards along the grid.
    row : float
        A row of a guard, with its derivatives.
    draw : float
        A random path that violates guards, enlarged as far as they allow.
    """

    gradient: float
    value: float
    iteration: float
    measure: float = 0.0
    row: float = 0.0
    draw: float = 0.0

    @property
    def step(self) -> float:
        """The least work of a step of a search."""
        return self.gradient + self.iteration + self.measure


@dataclass(slots=True)
class Meter:
    """Work done so far, and its limit."""

    allowed: float = float("inf")
    spent: float = 0.0

    @property
    def left(self) -> float:
        """Work that may still be done."""
        return max(self.allowed - self.spent, 0.0)

    @property
    def over(self) -> bool:
        """Whether the limit is reached."""
        return self.spent >= self.allowed


def search_costs(
    entries: int,
    nonzeros: int,
    samples: int,
    *,
    measure: float = 0.0,
    row: float = 0.0,
    draw: float = 0.0,
) -> Costs:
    """Return the costs of a search of a size.

    Parameters
    ----------
    entries : int
        Entries of the base regressor: torque joints x samples x base parameters.
    nonzeros : int
        Number of nonzeros of the linear limits' rows.
    samples : int
        Samples times joints, at which the linear limits are measured.
    measure, row, draw : float
        See `Costs`.
    """
    gradient = _ENTRY * entries
    iteration = _STEP + _NONZERO * nonzeros + _SHAPE * samples
    return Costs(gradient, _VALUE * gradient, iteration, measure, row, draw)
