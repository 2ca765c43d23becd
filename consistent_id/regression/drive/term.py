"""Friction laws and drive terms: columns of the regressor, and facts about them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError

TORQUE = ("N m", "N")
SPEED = ("rad/s", "m/s")


@brief
class JointSamples(NamedTuple):
    """One joint's samples: arrays of shape (samples,), or other numbers alike.

    CasADi expressions in designs and exports, intervals in proofs of torque limits.
    `load` is the torque that the joint transmits, [N m or N], for terms that need it.
    """

    q: Any
    dq: Any
    ddq: Any
    load: Any = None


@brief
class ShapeParameter(NamedTuple):
    """A number on which a term's columns depend nonlinearly.

    `unit` is for turning and for sliding joints; `fit_shapes` searches from `low` to
    `high`.
    """

    unit: tuple[str, str]
    low: float
    high: float


class DriveTerm(ABC):
    """Terms of a joint's torque that are linear in their coefficients.

    A law of one's own is a subclass with `names`, `unit` and `columns`, best a frozen
    dataclass; the other attributes have defaults that claim nothing.

    Attributes
    ----------
    names : tuple of str
        Names of the coefficients, one for each column.
    unit : tuple of (str, str)
        Unit of the coefficients, at a turning and at a sliding joint.
    smooth : bool
        The columns' derivatives in q, dq and ddq are continuous: a motion can be
        designed with this term.  See also `smoothed`.
    polynomial : bool
        The columns are polynomials in q, dq and ddq: proofs of torque limits use their
        derivatives in time, which is tighter and faster than intervals alone.
    nonnegative : bool
        A negative coefficient makes no sense, because the term dissipates energy or
        stores it; `NonNegativeDrive` demands it.
    friction : bool
        Shown in the friction curves of a report.
    needs_load : bool
        The columns depend on the torque that the joint transmits.
    simulated_as : {"damping", "friction", "armature", "stiffness"}, optional
        The parameter of simulators (URDF, MuJoCo, Pinocchio) that is the coefficient.
        Terms without one are named in the notes of an export.
    shape_parameters : mapping of str to ShapeParameter
        Fields of the term that `fit_shapes` can find, by name.

    Examples
    --------
    >>> class Cubic(DriveTerm):
    ...     names, unit = ("cubic",), ("N m s^3/rad^3", "N s^3/m^3")
    ...
    ...     def columns(self, joint):
    ...         return [joint.dq**3]
    >>> from consistent_id import DriveTerms
    >>> DriveTerms(viscous=True, terms=[Cubic()]).names
    ('viscous', 'cubic')
    """

    __slots__ = ()
    names: ClassVar[tuple[str, ...]]
    unit: ClassVar[tuple[str, str]]
    smooth: ClassVar[bool] = False
    polynomial: ClassVar[bool] = False
    nonnegative: ClassVar[bool] = False
    friction: ClassVar[bool] = True
    needs_load: ClassVar[bool] = False
    simulated_as: ClassVar[
        Literal["damping", "friction", "armature", "stiffness"] | None
    ] = None
    shape_parameters: ClassVar[Mapping[str, ShapeParameter]] = {}

    @abstractmethod
    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return one column for each name.

        Written with ``+ - * / **``, ``abs`` and NumPy's functions, a column can be
        computed for arrays, CasADi expressions, intervals and source text alike.
        """

    def smoothed(self, velocity: float) -> "DriveTerm":
        """Return a smooth term that stands in for this one in a design.

        The term itself if it is smooth.  A term with a field `velocity_scale` has a
        jump where that is None, and becomes smooth by a value.

        Parameters
        ----------
        velocity : float, [rad/s or m/s]
            Below it, a jump at standstill may be a slope.

        Raises
        ------
        ProblemError
            If the term is not smooth and has no stand-in.
        """
        if "velocity_scale" in self.shape_parameters:
            if "velocity_scale" in self.shapes:
                return self
            scaled: DriveTerm = replace(self, velocity_scale=velocity)  # type: ignore[type-var]
            return scaled
        if self.smooth:
            return self
        raise ProblemError(
            f"{type(self).__name__} ({', '.join(self.names)}) is not smooth, and "
            "designs and simulations follow gradients: set smooth = True if its "
            "columns have a continuous derivative, or define smoothed(velocity) to "
            "return a term that stands in for it, or leave it out of their model"
        )

    @property
    def shapes(self) -> dict[str, float]:
        """Values of the shape parameters in use, by name."""
        values = {name: getattr(self, name) for name in self.shape_parameters}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def fading_velocity(self) -> float | None:
        """Velocity above which little is left of the term; None if it does not fade."""
        return None


_USES = {
    "ndarray": "arrays",
    "SX": "CasADi expressions, which designs and exports need",
    "Interval": "intervals, which proofs of torque limits need",
    "Jet": "Taylor series, which proofs need of terms that are called polynomial",
    "SourceText": "source text, which the NumPy export needs",
}


def term_columns(term: DriveTerm, joint: JointSamples) -> list[Any]:
    """Return a term's columns.

    Raises
    ------
    ProblemError
        If the term cannot be computed for numbers of this kind, or has not one column
        for each name.
    """
    try:
        columns = list(term.columns(joint))
    except (TypeError, AttributeError, ValueError, RuntimeError) as cause:
        kind, reason = type(joint.dq).__name__, str(cause).partition("\n")[0]
        raise ProblemError(
            f"the columns of {type(term).__name__} ({', '.join(term.names)}) cannot be "
            f"computed for {_USES.get(kind, kind)} ({type(cause).__name__}: {reason}); "
            "make them of + - * / **, abs and NumPy's elementary functions"
        ) from cause
    if len(columns) != len(term.names):
        raise ProblemError(
            f"{type(term).__name__} has {len(columns)} columns, but names "
            f"{len(term.names)} coefficients ({', '.join(term.names)})"
        )
    return columns


def require_sound(term: Any) -> None:
    """Check a term at some samples of motion.

    Raises
    ------
    ProblemError
        If it is not a drive term, lacks names or units, or has columns that are not
        finite.
    """
    if not isinstance(term, DriveTerm):
        raise ProblemError(
            f"{term!r} is no drive term; derive its class from DriveTerm"
        )
    kind = type(term).__name__
    for needed, example in (("names", '("cubic",)'), ("unit", '("N m", "N")')):
        value = getattr(term, needed, None)
        if not (isinstance(value, tuple) and value and all(map(_is_text, value))):
            raise ProblemError(f"{kind}.{needed} is {value!r}, expected as {example}")
    if len(term.unit) != 2:
        raise ProblemError(
            f"{kind}.unit is {term.unit!r}, expected two units: at a turning and at a "
            "sliding joint"
        )
    with np.errstate(all="ignore"):
        columns = term_columns(term, JointSamples(*_SAMPLES))
    for name, column in zip(term.names, columns, strict=True):
        values = np.asarray(column)
        if values.shape not in ((), _SAMPLES[0].shape) or not np.isfinite(values).all():
            raise ProblemError(
                f"the column {name} of {kind} is {values.tolist()} for three samples; "
                "expected three finite numbers"
            )


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


_SAMPLES = tuple(
    np.array(x)
    for x in ((0.3, -0.7, 0.2), (-0.5, 0.0, 1.0), (2.0, 0.1, -1.0), (3.0, -2.0, 0.4))
)
