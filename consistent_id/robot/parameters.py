"""Names, units and places of the parameters in the vector that is estimated."""

import unicodedata
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from consistent_id._support.arrays import freeze
from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.robot.inertia import INERTIAL_NAMES, INERTIAL_UNITS

_CONTROLS = ("Cc", "Cs", "Zl", "Zp")
"""Unicode's categories of control characters, halves of pairs and line separators."""

_FEW = 12  # names of which all are listed, the nearest first


@dataclass(frozen=True, slots=True)
class ParameterLayout:
    """The place of each parameter: ten per link, then drive terms and couplings.

    Parameters
    ----------
    links : tuple of str
        Names of the moving links; link ``k`` owns entries ``10 k .. 10 k + 9``.
    drive : tuple of (str, str)
        Joint and term, such as ``("elbow", "viscous")``, in order; after them, two
        joints and the term they share, ``("elbow+wrist", "coupling_viscous")``.
    drive_units : tuple of str
        Unit of each drive term.

    Examples
    --------
    >>> layout = ParameterLayout(("arm",), (("elbow", "viscous"),), ("N m s/rad",))
    >>> layout.names[0], layout.names[-1], len(layout)
    ('arm.m', 'elbow.viscous', 11)
    >>> layout.index("arm.Izz")
    9
    """

    links: tuple[str, ...]
    drive: tuple[tuple[str, str], ...] = ()
    drive_units: tuple[str, ...] = ()
    names: tuple[str, ...] = field(init=False)
    units: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        if len(self.drive) != len(self.drive_units):
            raise ProblemError(
                f"{len(self.drive)} drive terms, but {len(self.drive_units)} units"
            )
        inertial = [f"{link}.{name}" for link in self.links for name in INERTIAL_NAMES]
        names = (*inertial, *(f"{joint}.{term}" for joint, term in self.drive))
        repeated = {name for name in names if names.count(name) > 1}
        if repeated:
            raise ProblemError(f"parameter names are not unique: {sorted(repeated)}")
        freeze(self, names=names)
        units = (*INERTIAL_UNITS * len(self.links), *self.drive_units)
        freeze(self, units=units)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def inertial_size(self) -> int:
        """Number of inertial parameters, ten per link."""
        return 10 * len(self.links)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind of each parameter: its unit, and of drive terms the name too."""
        inertial = self.inertial_size
        drive = (name.rpartition(".")[2] for name in self.names[inertial:])
        units = zip(self.units[inertial:], drive, strict=True)
        return (*self.units[:inertial], *(" ".join(pair) for pair in units))

    def link_slice(self, link: int) -> slice:
        """Entries of the ten parameters of the link with this index."""
        return slice(10 * link, 10 * link + 10)

    def index(self, name: str) -> int:
        """Return the place of a parameter by its name.

        Raises
        ------
        ProblemError
            If there is no such parameter; the message lists near names.
        """
        try:
            return self.names.index(name)
        except ValueError:
            near = did_you_mean(name, self.names)
            raise ProblemError(f"no parameter named {name!r}; {near}") from None

    def drive_indices(self, term: str) -> tuple[int, ...]:
        """Entries of one drive term, such as ``"viscous"``, over all joints."""
        start = self.inertial_size
        return tuple(start + i for i, (_, t) in enumerate(self.drive) if t == term)


def require_known(
    names: Iterable[str],
    known: Collection[str],
    what: str,
    error: type[ConsistentIdError] = ProblemError,
) -> None:
    """Refuse names that are not known, with the nearest that are.

    Parameters
    ----------
    what : str
        Begins the sentence that the wrong name ends, such as ``"scene: no joint"``.
    """
    for name in names:
        if name not in known:
            raise error(f"{what} {name!r}; {did_you_mean(name, known)}")


def require_writable(
    names: Iterable[str], what: str, error: type[ConsistentIdError] = ProblemError
) -> None:
    r"""Refuse names with control characters, such as line breaks and tabulators.

    Robots' files, tables and code would not contain them as they are.

    Parameters
    ----------
    what : str
        Begins the sentence that the name continues, such as ``"robot 'arm': joint"``.

    Examples
    --------
    >>> require_writable(["elbow", "wrist\n2"], "arm: joint")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: arm: joint 'wrist\n2' has a control character ...
    """
    for name in names:
        control = [c for c in name if unicodedata.category(c) in _CONTROLS]
        if control:
            raise error(
                f"{what} {name!r} has a control character ({control[0]!r}), expected "
                "letters, digits and marks; rename it"
            )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint that lists the known names nearest to a wrong one."""
    import difflib

    known = list(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or known[:8]
    if len(known) <= _FEW:
        near += [other for other in known if other not in near]
    more = "" if len(near) == len(known) else f" (of {len(known)})"
    return f"known: {', '.join(near)}{more}" if known else "there are none"
