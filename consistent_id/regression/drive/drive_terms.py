"""The drive terms of a joint, and the keywords that choose the known ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict, Unpack, get_args

import numpy as np

from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.regression.drive.laws import (
    AsymmetricCoulomb,
    Coulomb,
    Drag,
    FrictionSlope,
    LoadFriction,
    Offset,
    RotorInertia,
    Spring,
    Stribeck,
    Viscous,
)
from consistent_id.regression.drive.term import (
    DriveTerm,
    JointSamples,
    require_sound,
    term_columns,
)
from consistent_id.robot.parameters import require_known

CoulombShape = Literal["sign", "tanh", "none"]


class DriveOptions(TypedDict, total=False):
    """Keywords of `DriveTerms`, and keys of a problem file's drive tables."""

    viscous: bool
    coulomb: CoulombShape
    velocity_scale: float | None
    offset: bool
    rotor_inertia: bool
    spring: bool
    asymmetric: bool
    stribeck_velocity: float | None
    stribeck_exponent: float
    load_friction: bool
    drag: bool
    friction_slope: bool


LAWS: Mapping[str, type[DriveTerm]] = {
    "viscous": Viscous,
    "drag": Drag,
    "coulomb": Coulomb,
    "asymmetric": AsymmetricCoulomb,
    "friction_slope": FrictionSlope,
    "stribeck_velocity": Stribeck,
    "load_friction": LoadFriction,
    "offset": Offset,
    "rotor_inertia": RotorInertia,
    "spring": Spring,
}
"""The terms that each keyword chooses, in the order of the columns.

The fields of a law are keywords too.
"""

_NOT_FALSE = {
    "coulomb": "none",
    "velocity_scale": None,
    "stribeck_velocity": None,
    "stribeck_exponent": 2.0,
}
DEFAULTS: Mapping[str, Any] = {
    name: _NOT_FALSE.get(name, False) for name in DriveOptions.__annotations__
}
"""Values of the keywords that choose nothing."""

_FIRST = 10  # keywords that a fingerprint has always shown, chosen or not


@brief
@dataclass(frozen=True, slots=True, init=False, repr=False)
class DriveTerms:
    """The terms of a joint's torque besides the rigid-body ones.

    ``tau = viscous dq + coulomb s(dq) + offset + rotor_inertia ddq + spring q``

    and, where friction is not that simple,

    ``+ s(dq) (stribeck exp(-|dq / stribeck_velocity|^stribeck_exponent)
    + load_friction |load|)``.

    Parameters
    ----------
    viscous : bool
        Term in ``dq``, [N m s/rad] or [N s/m].
    coulomb : {"sign", "tanh", "none"}
        Term in ``sign(dq)`` or ``tanh(dq / velocity_scale)``, [N m] or [N].
    velocity_scale : float, [rad/s] or [m/s]
        Velocity at which the smooth Coulomb term reaches ``tanh(1) = 0.76`` of its
        value; needed for ``"tanh"`` and meaningless otherwise.
    offset : bool
        Constant term, [N m] or [N].
    rotor_inertia : bool
        Term in ``ddq``, reflected through the gear, [kg m^2] or [kg].
    spring : bool
        Term in ``q``, [N m/rad] or [N/m]; with an offset, a spring under preload.
    asymmetric : bool
        Two Coulomb levels instead of one, ``coulomb_positive`` and
        ``coulomb_negative``, one for each direction; instead of an offset, from which
        they differ near standstill alone.
    stribeck_velocity : float, optional, [rad/s] or [m/s]
        Velocity at which what friction at rest has beyond the Coulomb level fades;
        without it there is no such term.
    stribeck_exponent : float
        How abruptly it fades: 2 for a bell, 1 for an exponential.
    load_friction : bool
        Term in ``s(dq) |load|``, a pure number; see `TorqueModel`, which computes the
        load.
    drag : bool
        Term in ``dq |dq|``, [N m s^2/rad^2] or [N s^2/m^2].
    friction_slope : bool
        Term in ``s(dq) q``, [N m/rad] or [N/m]: Coulomb friction that varies with
        position.
    terms : sequence of DriveTerm
        Terms as values, such as laws of one's own.  The keywords given change and add
        to them.

    Notes
    -----
    All coefficients are linear in the torque; `velocity_scale`, `stribeck_velocity` and
    `stribeck_exponent` are shapes, which `fit_shapes` finds.

    Examples
    --------
    >>> DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02).names
    ('viscous', 'coulomb')
    >>> DriveTerms(coulomb="sign", asymmetric=True, stribeck_velocity=0.1).names
    ('coulomb_positive', 'coulomb_negative', 'stribeck')
    """

    terms: tuple[DriveTerm, ...]

    def __init__(
        self,
        *values: Any,
        terms: Sequence[DriveTerm] = (),
        **options: Unpack[DriveOptions],
    ) -> None:
        given = _given(values, options)
        chosen, own = tuple(terms), []
        for term in chosen:
            if type(term) not in LAWS.values():
                require_sound(term)
                own.append(term)
        known = [term for term in chosen if type(term) in LAWS.values()]
        now = _options(known)
        if set(_from_options(now)) != set(known) and given:
            raise ProblemError(
                f"keywords ({', '.join(given)}) cannot change {known}, which keywords "
                "cannot choose; give all of them in terms"
            )
        if given:
            chosen = (*_from_options(now | given), *own)
        _require_distinct(chosen)
        object.__setattr__(self, "terms", chosen)

    def __getattr__(self, name: str) -> Any:
        """Return the value of a keyword, such as ``"viscous"``."""
        if name in DEFAULTS:
            return self.options[name]
        raise AttributeError(f"'DriveTerms' object has no attribute {name!r}")

    def __repr__(self) -> str:
        if _from_options(self.options) != self.terms:
            return f"DriveTerms(terms={self.terms!r})"
        shown = [
            f"{name}={value!r}"
            for i, (name, value) in enumerate(self.options.items())
            if i < _FIRST or value != DEFAULTS[name]
        ]
        return f"DriveTerms({', '.join(shown)})"

    @property
    def options(self) -> dict[str, Any]:
        """The keywords that choose these terms, those of one's own left out."""
        return _options(self.terms)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of their columns."""
        return tuple(name for term in self.terms for name in term.names)

    @property
    def needs_load(self) -> bool:
        """Whether a term depends on the torque that the joint transmits."""
        return any(term.needs_load for term in self.terms)

    @property
    def shapes(self) -> dict[str, float]:
        """Numbers that the columns' shapes depend on, by name."""
        return {k: v for term in self.terms for k, v in term.shapes.items()}

    def columns(self, q: Any, dq: Any, ddq: Any, load: Any = None) -> list[Any]:
        """Return the coefficients' columns for one joint's samples.

        Like the samples, they are arrays of shape (samples,) or CasADi expressions; the
        offset's is the number one.  `load` is the torque that the joint transmits.
        """
        joint = JointSamples(q, dq, ddq, load)
        return [column for term in self.terms for column in term_columns(term, joint)]

    def with_shapes(self, values: Mapping[str, float]) -> "DriveTerms":
        """Return the terms with some shapes changed, those they have."""
        changed = []
        for term in self.terms:
            mine = {k: v for k, v in values.items() if k in term.shape_parameters}
            changed.append(replace(term, **mine) if mine else term)  # type: ignore[type-var]
        return DriveTerms(terms=changed)

    def smoothed(self, velocity: float) -> "DriveTerms":
        """Return smooth terms that stand in for these in a design.

        Raises
        ------
        ProblemError
            If a term is not smooth and has no stand-in.
        """
        return DriveTerms(terms=[term.smoothed(velocity) for term in self.terms])


def _given(values: Sequence[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords given, by place or by name."""
    by_place = dict(zip(DEFAULTS, values, strict=False))
    if len(by_place) < len(values) or by_place.keys() & options.keys():
        raise ProblemError(
            f"{len(values)} drive options by place, and {', '.join(options) or 'none'} "
            f"by name; expected each of {', '.join(DEFAULTS)} once at most"
        )
    require_known(options, DEFAULTS, "no drive term")
    return {**by_place, **options}


def _from_options(options: Mapping[str, Any]) -> tuple[DriveTerm, ...]:
    """Return the terms that the keywords choose."""
    _require_direction(options["coulomb"], options["velocity_scale"])
    chosen: list[DriveTerm] = []
    for name, law in LAWS.items():
        if options[name] in (False, None, "none"):
            continue
        if "velocity_scale" in law.shape_parameters and options["coulomb"] == "none":
            raise ProblemError(
                f'{name} is {options[name]}, but coulomb is "none"; it needs a '
                'direction of motion: choose coulomb "sign" or "tanh"'
            )
        if not (law is Coulomb and options["asymmetric"]):
            chosen.append(
                law(**{field: options[field] for field in law.shape_parameters})
            )
    if options["asymmetric"] and options["offset"]:
        raise ProblemError(
            "asymmetric Coulomb friction and an offset differ near standstill alone; "
            "choose one of them"
        )
    return tuple(chosen)


def _require_direction(shape: str, velocity_scale: float | None) -> None:
    if shape not in get_args(CoulombShape):
        known = ", ".join(get_args(CoulombShape))
        raise ProblemError(f"coulomb is {shape!r}, expected one of {known}")
    if (shape == "tanh") is (velocity_scale is None):
        raise ProblemError(
            f"velocity_scale is {velocity_scale}, but coulomb is {shape!r}; 'tanh' "
            "needs the velocity at which it saturates, and nothing else has one"
        )


def _options(terms: Sequence[DriveTerm]) -> dict[str, Any]:
    """Return the keywords that choose the terms, those of one's own left out."""
    options = dict(DEFAULTS)
    for name, law in LAWS.items():
        for term in (term for term in terms if type(term) is law):
            options |= {name: True, **term.shapes}
            if "velocity_scale" in law.shape_parameters:
                options["coulomb"] = "sign"
    if options["velocity_scale"] is not None:
        options["coulomb"] = "tanh"
    return options


def _require_distinct(terms: Sequence[DriveTerm]) -> None:
    """Refuse equal names of coefficients, and shapes that differ or make no sense."""
    names = [name for term in terms for name in term.names]
    shapes: dict[str, float] = {}
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"two drive terms are named {name!r}; choose one")
    for term in terms:
        for name, value in term.shapes.items():
            if not 0.0 < value < np.inf:
                raise ProblemError(f"{name} is {value}, expected a positive number")
            if shapes.setdefault(name, value) != value:
                raise ProblemError(
                    f"{name} is {shapes[name]} in one drive term and {value} in "
                    "another; a joint has one value of each shape"
                )
