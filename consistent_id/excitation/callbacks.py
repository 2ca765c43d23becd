"""Python functions as CasADi functions; imported only where a programme is solved."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from consistent_id._support.arrays import Array, Vector

PythonFunction = Callable[[Vector], tuple[Any, Array]]


class Differentiable(ca.Callback):
    """A Python function that returns its value and its Jacobian.

    Parameters
    ----------
    name : str
    inputs, outputs : int
    function : callable
        ``x -> (value, jacobian)``.
    """

    def __init__(
        self, name: str, inputs: int, outputs: int, function: PythonFunction
    ) -> None:
        super().__init__()
        self._shape = (outputs, inputs)
        self.memory = Memory(function, outputs)
        self._jacobian: _Jacobian | None = None
        self.construct(name)

    def get_sparsity_in(self, _: int) -> Any:
        """Sparsity of the argument."""
        return ca.Sparsity.dense(self._shape[1], 1)

    def get_sparsity_out(self, _: int) -> Any:
        """Sparsity of the value."""
        return ca.Sparsity.dense(self._shape[0], 1)

    def eval(self, arguments: Any) -> list[Any]:
        """Return the value."""
        value, _ = self.memory(arguments[0].full().ravel())
        return [ca.DM(value)]

    def has_jacobian(self, *_: Any) -> bool:
        """Say that there is a Jacobian."""
        return True

    def get_jacobian(self, name: str, *_: Any) -> Any:
        """Return the Jacobian as a CasADi function."""
        self._jacobian = _Jacobian(name, self._shape, self.memory)
        return self._jacobian


class _Jacobian(ca.Callback):
    def __init__(self, name: str, shape: tuple[int, int], memory: "Memory") -> None:
        super().__init__()
        self._shape, self.memory = shape, memory
        self.construct(name)

    def get_n_in(self) -> int:
        return 2  # the argument, and the value there

    def get_sparsity_in(self, place: int) -> Any:
        return ca.Sparsity.dense(self._shape[1 - place], 1)

    def get_sparsity_out(self, _: int) -> Any:
        return ca.Sparsity.dense(*self._shape)

    def eval(self, arguments: Any) -> list[Any]:
        _, jacobian = self.memory(arguments[0].full().ravel())
        return [ca.DM(np.reshape(jacobian, self._shape))]


class Observer(ca.Callback):
    """Passes each iterate to a function, which returns whether to stop."""

    def __init__(self, inputs: int, rows: int, watch: Callable[[Vector], bool]) -> None:
        super().__init__()
        self._inputs, self._rows, self._watch = inputs, rows, watch
        self.construct("observer")

    def get_n_in(self) -> int:
        """Return the number of arguments from a solver."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of values for the solver."""
        return 1

    def get_sparsity_in(self, place: int) -> Any:
        """Sparsity of the arguments from a solver."""
        name = ca.nlpsol_out(place)
        sizes = {"f": 1, "x": self._inputs, "lam_x": self._inputs}
        sizes |= {"g": self._rows, "lam_g": self._rows}
        return ca.Sparsity.dense(sizes.get(name, 0), 1 if name in sizes else 0)

    def eval(self, arguments: Any) -> list[Any]:
        """Pass on the iterate."""
        return [int(self._watch(arguments[0].full().ravel()))]


class QuasiNewton(ca.Callback):
    """A dense approximation of the Lagrangian's curvature, updated at each iterate.

    Damped BFGS [Nocedal2006]_: ``B += r r^T / (s.r) - B s s^T B / (s.B s)`` with ``r``
    the change of the gradient, mixed with ``B s`` where curvature along the step ``s``
    is small or negative, so that ``B`` stays positive definite.  IPOPT's own
    limited-memory form solves the large system of rows once for each vector it keeps;
    this one, of the few variables, costs a single solve.

    Parameters
    ----------
    inputs : int
    linear : int
        Rows that come first and have no curvature.
    objective, rows : Memory
        Values of the nonlinear functions; `rows` is None if there are none.
    """

    def __init__(
        self, inputs: int, linear: int, objective: "Memory", rows: "Memory | None"
    ) -> None:
        super().__init__()
        self._inputs, self._linear = inputs, linear
        self._objective, self._rows = objective, rows
        self._point: Vector | None = None
        self._slopes: tuple[Array, Array]
        self._matrix: Array | None = None
        self._pattern = ca.Sparsity.upper(inputs)
        self._nonzeros = np.tril_indices(inputs)  # of the transpose: column by column
        self.construct("curvature")

    def get_n_in(self) -> int:
        """Count the point, the parameters and the two kinds of multipliers."""
        return 4

    def get_sparsity_in(self, place: int) -> Any:
        """Sparsity of each."""
        rows = self._linear + (0 if self._rows is None else self._rows.size)
        return ca.Sparsity.dense((self._inputs, 0, 1, rows)[place], 1)

    def get_sparsity_out(self, _: int) -> Any:
        """Sparsity of the upper triangle."""
        return self._pattern

    def eval(self, arguments: Any) -> list[Any]:
        """Return the upper triangle of the approximation, after the latest step."""
        x, _, factor, multipliers = (a.full().ravel() for a in arguments)
        slopes = self._first_derivatives(x)
        if self._point is not None and not np.array_equal(x, self._point):
            weights = multipliers[self._linear :] / (factor[0] or 1.0)
            was, now = self._slopes, slopes
            change = now[0] - was[0] + (now[1] - was[1]).T @ weights
            self._matrix = updated_curvature(self._matrix, x - self._point, change)
        self._point, self._slopes = x, slopes
        matrix = np.eye(self._inputs) if self._matrix is None else self._matrix
        return [ca.DM(self._pattern, factor[0] * matrix[self._nonzeros])]

    def _first_derivatives(self, x: Vector) -> tuple[Array, Array]:
        _, gradient = self._objective(x)
        if self._rows is None:
            return gradient, np.zeros((0, self._inputs))
        return gradient, np.asarray(self._rows(x)[1])


def updated_curvature(matrix: Array | None, step: Vector, change: Vector) -> Array:
    """Return the approximation after a step and the change of the gradient along it."""
    if matrix is None:
        size = float(abs(change @ step) / (step @ step))
        matrix = max(size, 1e-8) * np.eye(len(step))
    Bs = matrix @ step
    sBs, sr = step @ Bs, step @ change
    if sr < 0.2 * sBs:
        mix = 0.8 * sBs / (sBs - sr)
        change = mix * change + (1.0 - mix) * Bs
    if not step @ change > 0.0:
        return matrix  # a step of the size of rounding shows no curvature
    growth = np.outer(change, change) / (step @ change)
    return np.asarray(matrix + growth - np.outer(Bs, Bs) / sBs)


class Memory:
    """The last point: its value and its derivative are requested in separate calls."""

    def __init__(self, function: PythonFunction, size: int) -> None:
        self.size = size
        self._function = function
        self._point: Vector | None = None
        self._answer: tuple[Any, Array]

    def __call__(self, point: Vector) -> tuple[Any, Array]:
        """Return value and Jacobian."""
        if self._point is None or not np.array_equal(point, self._point):
            self._answer = self._function(point)
            self._point = point
        return self._answer
