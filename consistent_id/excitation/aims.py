"""The forms of paths to choose from, the objective of a design, and what it is for.

A motion is for parameters of interest; others are unknown, or known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector, checked, freeze, frozen, number
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.excitation.criteria import Objective, Scaling
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import FourierTrajectory, harmonics_of
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import (
    BaseParameters,
    base_of_some,
    base_parameters,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.row_structure import RowModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout, did_you_mean

CORRELATION_TIME = 0.2
"""Seconds over which residuals of real robots are correlated: 0.1 to 0.35."""
_COMMON = 1e-9  # relative difference below which two frequencies are one

_HARMONICS = (5, 8, 12)  # in a path of ten seconds, for arms of usual speed
_SECONDS = 10.0
_PERIOD = 5.0  # s, least period of paths from rest to rest,
_REPEATED = 8  # harmonics at least, of a path that repeats: five found less
_CROSSED = 0.7  # and part of a swing over the whole range that fits into it
_USUAL = 0.1  # Hz; half a range at full speed, of arms between 0.05 and 0.2
_FASTER = 10.0  # most times as fast as usual
_MUCH = 5.0  # times as fast as usual, from where the usual harmonics are tried, too
_MOST = 24  # harmonics; beyond it, the base frequency is raised

Others = Literal["unknown", "known"]
"""Whether parameters that a motion is not for are known already."""

PAYLOAD = ("payload", "tool")
"""Words for the ten parameters of the last link's load."""


@brief
@dataclass(frozen=True, slots=True)
class PathForm:
    """The family of Fourier paths to choose from.

    Parameters
    ----------
    duration : float, [s]
    harmonics : int
        Number of harmonics of each base frequency.
    base_frequencies : float or sequence of float, optional, [Hz]
        By default the one whose period is the duration.
    rest : bool
        Whether velocity and acceleration are zero at both ends; without it, a periodic
        path is entered at full speed and needs a run-in.
    smooth : bool
        Whether the jerk is zero at both ends, too: it is continuous from rest to rest.
    between : bool
        Use frequencies half-way below the harmonics, except harmonics of another base:
        such a path has no frequency in common with one of the same form without this
        option and, with one base, it is orthogonal to it over two periods, joint by
        joint.

    Examples
    --------
    >>> PathForm(10.0, 3).frequencies.round(9).tolist()
    [0.1, 0.2, 0.3]
    >>> PathForm(10.0, 3, between=True).frequencies.round(9).tolist()
    [0.05, 0.15, 0.25]
    """

    duration: float = 10.0
    harmonics: int = 5
    base_frequencies: float | tuple[float, ...] | None = None
    rest: bool = True
    between: bool = False
    smooth: bool = False

    def __post_init__(self) -> None:
        if self.smooth and not self.rest:
            raise ProblemError(
                "smooth needs a path that rests at its ends; give rest = true"
            )
        duration, harmonics = (
            number(getattr(self, name), name) for name in ("duration", "harmonics")
        )
        if not 0.0 < duration < np.inf:
            raise ProblemError(f"duration is {duration} s, expected more than 0")
        if not 1.0 <= harmonics < np.inf or harmonics % 1.0:
            raise ProblemError(
                f"harmonics is {self.harmonics}, expected a whole number, 1 or more"
            )
        freeze(self, duration=duration, harmonics=int(harmonics))
        self.frequencies  # noqa: B018  frequencies that make no sense are refused here

    @property
    def frequencies(self) -> Vector:
        """The frequencies of its terms [Hz]."""
        base = self.base_frequencies
        base = 1.0 / self.duration if base is None else base
        if not self.between:
            return harmonics_of(base, self.harmonics)
        own, count = harmonics_of(base, self.harmonics), 2 * self.harmonics
        odd = [harmonics_of(b / 2.0, count)[::2] for b in np.atleast_1d(base)]
        # With several bases, a half of one may be a harmonic of another.  The least
        # base's half is none.
        every = np.sort(np.concatenate(odd))
        new = abs(every[:, None] - own).min(axis=1) > _COMMON * every
        return np.asarray(every[new & (np.diff(every, prepend=0.0) > _COMMON * every)])

    @property
    def period(self) -> float:
        """Time of one repetition [s]: the duration, or a whole part of it."""
        still = np.zeros((len(self.frequencies), 1))
        found = FourierTrajectory(
            ("any",), self.frequencies, np.zeros(1), still, still, self.duration
        ).period
        repeats = 1 if found is None else max(round(self.duration / found), 1)
        whole = found is not None and np.isclose(repeats * found, self.duration)
        return self.duration / repeats if whole else self.duration


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """The objective of a design, and properties of the recording.

    Parameters
    ----------
    objective : {"D", "condition", "A", "E", "task"}
        Of the standard errors of the base parameters, the mean logarithm (D), the root
        sum of squares (A), the largest (E); the condition number of the base
        regressor; or the predicted torque error on `task`.
    refine : {"D", "A", "E", "task", "default"}, optional
        Objective of a second stage, which may let the condition number grow to
        `growth` times the best.  By default D after the condition number, and no
        second stage after other objectives.
    growth : float
    condition_at_most : float, optional
        Condition number that the design may not exceed: the least one is searched for
        first, then the objective under this bound.
    scaling : {"none", "unit columns"}
        Scaling of the regressor's columns in condition numbers; errors are those of the
        parameters in their own units.
    noise : array_like or mapping, optional, [N m or N]
        Standard deviation of each torque joint's noise; its rows are divided by it.  By
        default half a percent of each joint's effort limit (the residuals of a UR10e's
        torque are 0.4 to 0.7 %), or, for a condition number, one for all.
    rate : float, [Hz]
        Rate at which the path will be recorded.
    correlation_time : float, [s]
        Time over which residuals are correlated, friction's errors included, as on real
        robots; 0 for white noise.  Earlier recordings have their own.
    earlier : Regression or sequence of Regression
        Earlier recordings, whose information is added.
    task : Recording, optional
        Motion whose torque is to be predicted.
    assumed_noise : bool
        Whether the noise is the default one.
    interest : sequence of str
        Parameters whose errors D, A and E describe, with all others unknown: names of
        parameters, of links or joints for all their parameters, ``*`` for any letters.
        By default all.
    others : {"unknown", "known"}
        Of the parameters that are not of interest.  For a load that is weighed by the
        difference between two logs they are known: by the log without it.

    Examples
    --------
    >>> import consistent_id as ci
    >>> ci.Aim("D", rate=100.0, interest=["link3.*"]).objective
    'D'
    """

    objective: Objective = "D"
    refine: Objective | Literal["default"] | None = "default"
    growth: float = 1.5
    condition_at_most: float | None = None
    scaling: Scaling = "none"
    noise: ArrayLike | dict[str, float] | None = None
    rate: float = 100.0
    correlation_time: float = CORRELATION_TIME
    earlier: Regression | Sequence[Regression] = ()
    task: Recording | None = None
    assumed_noise: bool = False
    interest: Sequence[str] = ()
    others: Others = "unknown"

    def __post_init__(self) -> None:
        for name in ("objective", "refine"):
            value = getattr(self, name)
            if name == "refine" and value in (None, "default"):
                continue
            if value not in get_args(Objective):
                known = ", ".join(get_args(Objective))
                raise ProblemError(f"{name} is {value!r}, expected one of {known}")
            if value == "task" and self.task is None:
                raise ProblemError(
                    f"{name} is 'task', but there is no task; give the motion whose "
                    "torque is to be predicted"
                )
        if self.scaling not in get_args(Scaling):
            known = ", ".join(get_args(Scaling))
            raise ProblemError(f"scaling is {self.scaling!r}, expected one of {known}")
        if not 1.0 <= number(self.growth, "growth") < np.inf:
            raise ProblemError(f"growth is {self.growth}, expected 1 or more")
        if not 0.0 < number(self.rate, "rate") < np.inf:
            raise ProblemError(f"rate is {self.rate} Hz, expected more than 0")
        if not 0.0 <= number(self.correlation_time, "correlation_time") < np.inf:
            raise ProblemError(
                f"correlation_time is {self.correlation_time} s, expected 0 or more"
            )
        most = self.condition_at_most
        if most is not None and not 1.0 <= number(most, "condition_at_most") < np.inf:
            raise ProblemError(f"condition_at_most is {most}, expected 1 or more")
        if self.task is not None and not isinstance(self.task, Recording):
            raise ProblemError(
                f"task is {type(self.task).__name__}, expected a Recording"
            )
        if not isinstance(self.noise, dict | None):
            _noise(self.noise)
        _require_regressions(self.earlier)
        self._require_interest()

    def _require_interest(self) -> None:
        words = self.interest
        if isinstance(words, str) or not all(isinstance(word, str) for word in words):
            raise ProblemError(
                f"interest is {words!r}, expected a list of names, such as "
                "['tool', 'elbow.viscous']"
            )
        freeze(self, interest=tuple(words))
        if words and not {"D", "A", "E"} & set(self.objectives):
            raise ProblemError(
                "interest needs an objective of errors, but the objective is "
                f"{', '.join(self.objectives)}; choose D, A or E"
            )

        if self.others not in get_args(Others):
            known = ", ".join(get_args(Others))
            raise ProblemError(f"others is {self.others!r}, expected one of {known}")
        if self.others == "known" and (self.recordings or not words):
            raise ProblemError(
                "others are known: expected parameters of interest, and no earlier "
                "recordings; name those that the motion is for, such as 'payload'"
            )

    def noise_of(self, joints: tuple[str, ...]) -> Vector:
        """Return the noise of the named joints [N m or N].

        Raises
        ------
        ProblemError
            If it does not fit them, or is not positive.
        """
        given = 1.0 if self.noise is None else self.noise
        if isinstance(given, dict):
            for name in given:
                if name not in joints:
                    near = did_you_mean(name, joints)
                    raise ProblemError(f"noise of {name!r}: no such joint; {near}")
            if missing := [name for name in joints if name not in given]:
                raise ProblemError(f"noise of {', '.join(missing)} is missing")
            given = [given[name] for name in joints]
        values = _noise(given)
        if values.ndim == 0:
            values = np.full(len(joints), float(values))
        noise = frozen(values, (len(joints),), "noise")
        if not (noise > 0.0).all():
            raise ProblemError(f"noise is {noise.tolist()}, expected positive values")
        return noise

    @property
    def objectives(self) -> tuple[Objective, ...]:
        """The objectives of its stages, one or two."""
        refine = self.refine
        if refine == "default":
            refine = "D" if self.objective == "condition" else None
        if self.condition_at_most is not None and self.objective != "condition":
            return "condition", refine or self.objective
        if refine in (None, self.objective):
            return (self.objective,)
        return self.objective, refine

    @property
    def recordings(self) -> tuple[Regression, ...]:
        """Earlier regressions as a tuple."""
        one = isinstance(self.earlier, Regression)
        return (self.earlier,) if one else tuple(self.earlier)  # type: ignore[return-value,arg-type]


def forms_to_try(
    limits: MotionLimits,
    duration: float = _SECONDS,
    *,
    rest: bool = True,
    smooth: bool = False,
) -> tuple[PathForm, ...]:
    """Return forms of one duration with more and more harmonics.

    A path from rest to rest repeats: its period is near five seconds for arms that can
    swing over their range in seven or less, and longer for slower ones.  A search
    over short periods has fewer variables and gets further in the same work
    (docs/excitation-evidence.md, (h)).

    In ten seconds, the highest frequencies of arms are 0.5, 0.8 and 1.2 Hz, and twice
    as much in five; those of robots that cross half of their range faster than in ten
    seconds, such as legs, are higher in proportion.  Very fast robots have 8 harmonics
    as another form.

    Parameters
    ----------
    duration : float, [s]
    rest, smooth : bool
        See `PathForm`.  The period of a path that does not rest is the duration.

    Examples
    --------
    >>> limits = MotionLimits(("a",), [-2], [2], [2], [9], [np.inf], [np.inf])
    >>> forms = forms_to_try(limits, 10.0)
    >>> [(form.harmonics, form.period) for form in forms]
    [(8, 5.0), (12, 5.0)]
    """
    half = limits.derivative(0)
    speed = np.minimum(limits.velocity, np.sqrt(limits.acceleration * half))
    speed = np.minimum(speed, np.cbrt(limits.jerk * half**2))
    crossing = float(np.median(speed / (2.0 * np.pi * half)))
    faster = float(np.clip(crossing / _USUAL, 1.0, _FASTER))
    usual = [(_HARMONICS[1], 1.0)] if faster > _MUCH else []
    period = duration
    if rest:
        period = _whole(duration, max(_PERIOD, _CROSSED / crossing))
    least = _REPEATED if period < duration else 1
    forms = []
    for harmonics, times in [*usual, *((one, faster) for one in _HARMONICS)]:
        count = max(round(harmonics * period / _SECONDS * times), harmonics, least)
        multiple = -(-count // _MOST)
        base = None if period == duration and multiple == 1 else multiple / period
        forms.append(
            PathForm(duration, round(count / multiple), base, rest, smooth=smooth)
        )
    return tuple(dict.fromkeys(forms))


def _whole(duration: float, period: float) -> float:
    """Return the period nearest to one that fits into a duration a whole time."""
    return duration / max(round(duration / period), 1)


def _noise(given: ArrayLike) -> Vector:
    """Return one number, or several; their count is checked later."""
    try:
        several = np.ndim(given) > 0
    except ValueError as cause:
        raise ProblemError(f"noise: expected numbers, got {cause}") from None
    return (
        checked(given, (None,), "noise")
        if several
        else np.array(number(given, "noise"))
    )


def _require_regressions(given: object) -> None:
    every = given if isinstance(given, Sequence) else (given,)
    for one in every:
        if not isinstance(one, Regression):
            raise ProblemError(
                f"earlier holds a {type(one).__name__}, expected regressions; call "
                "build_regression for each recording"
            )


def parameters_named(layout: ParameterLayout, words: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of parameters, in ascending order.

    Parameters
    ----------
    layout : ParameterLayout
    words : sequence of str
        Names of parameters (``"elbow.viscous"``), or of links and joints for all their
        parameters; ``*`` stands for any letters.

    Raises
    ------
    ProblemError
        If a word names nothing.

    Examples
    --------
    >>> layout = ParameterLayout(("arm",), (("elbow", "viscous"),), ("N m s/rad",))
    >>> parameters_named(layout, ["elbow", "arm.I*z"])
    (7, 8, 9, 10)
    """
    found: set[int] = set()
    for word in words:
        named = _named(layout, word)
        if not named:
            owners = dict.fromkeys(n.rpartition(".")[0] for n in layout.names)
            near = did_you_mean(word, [*owners, *layout.names])
            raise ProblemError(
                f"interest: no parameter, link or joint {word!r}; {near}"
            )
        found |= named
    return tuple(sorted(found))


def interest_names(robot: RobotModel, words: Sequence[str]) -> tuple[str, ...]:
    """Return names of parameters, links and joints in place of words for a load.

    A load, such as a payload or a tool, adds to the ten parameters of the link that
    carries it: ``"payload"`` and ``"tool"`` stand for those of each last link, and a
    link that is fixed to a moving one, such as ``"tool0"``, for those of the moving
    one. A link or joint with such a name has precedence.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    >>> interest_names(arm, ["payload", "joint1"])
    ('link2.*', 'joint1')
    """
    own = {*robot.link_names, *robot.joint_names}
    parents = {joint.parent for joint in robot.joints}
    last = [name for k, name in enumerate(robot.link_names) if k not in parents]
    fixed = {frame.name: link.name for link in robot.links for frame in link.merged}
    names: list[str] = []
    for word in words:
        if word in own:
            names.append(word)
        elif word in fixed:
            names.append(f"{fixed[word]}.*")
        elif word in PAYLOAD:
            names += [f"{name}.*" for name in last]
        else:
            names.append(word)
    return tuple(names)


def base_for(
    model: RowModel, words: Sequence[str], *, known: bool = False
) -> BaseParameters:
    """Return base parameters of which some contain only those of interest.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    words : sequence of str
    known : bool
        Whether all other parameters are known: base parameters are then those of
        interest alone.

    Raises
    ------
    ProblemError
        If a word names nothing, or nothing of interest can be separated from the
        others.
    """
    named = parameters_named(model.layout, words)
    base = base_of_some(model, named) if known else base_parameters(model, last=named)
    if words and not places_of_interest(base, words):
        raise ProblemError(
            f"interest: no motion separates {', '.join(words)} from the other "
            f"parameters; name more of them, such as the links before and after"
        )
    return base


def places_of_interest(base: BaseParameters, words: Sequence[str]) -> tuple[int, ...]:
    """Return base parameters that are led by one of interest; none without words."""
    named = set(parameters_named(base.layout, words))
    return tuple(k for k, i in enumerate(base.independent) if i in named)


def is_named(layout: ParameterLayout, word: str) -> bool:
    """Return whether a word names a parameter, or a link or joint that has some."""
    return bool(_named(layout, word))


def _named(layout: ParameterLayout, word: str) -> set[int]:
    return {
        i
        for i, name in enumerate(layout.names)
        if _fits(name, word) or _fits(name.rpartition(".")[0], word)
    }


def _fits(name: str, word: str) -> bool:
    return name == word or fnmatchcase(name, word)
