"""The errors a user can meet.

Each message says what was seen (file, row, joint, value, unit), what was
expected, and what to do about it.
"""

import shlex
from collections.abc import Callable, Sequence
from functools import partial


class ConsistentIdError(Exception):
    """Root of every error that the package raises on purpose.

    Parameters
    ----------
    options : str
        Options that may be added to the command, filled in, as in a shell.
    replaces : sequence of str
        Words of the command in whose place it stands; by default it is added.

    Examples
    --------
    >>> import consistent_id as ci
    >>> try:
    ...     ci.load_robot("missing.urdf")
    ... except ci.ConsistentIdError as error:
    ...     print(type(error).__name__)
    ModelError
    """

    def __init__(
        self, *message: object, options: str = "", replaces: Sequence[str] = ()
    ) -> None:
        super().__init__(*message)
        self.options, self.replaces = options, tuple(replaces)

    @property
    def option_names(self) -> frozenset[str]:
        """The names of the options, such as ``--lock``, without their values."""
        return frozenset(w for w in shlex.split(self.options) if w.startswith("--"))


class ModelError(ConsistentIdError):
    """The robot's description cannot be used as it is.

    Examples
    --------
    >>> import consistent_id as ci
    >>> ci.load_robot("missing.urdf")
    Traceback (most recent call last):
    consistent_id.errors.ModelError: missing.urdf: cannot be read (No such ...
    """


class RecordingError(ConsistentIdError):
    """A recording cannot be read, or has values that no robot wrote.

    Examples
    --------
    >>> import consistent_id as ci
    >>> ci.Recording(("elbow",), [0.0, 0.0], [[1.0], [2.0]])
    Traceback (most recent call last):
    consistent_id.recordings.time_stamps.SampleError: recording: time goes from ...
    """


class ProblemError(ConsistentIdError):
    """A problem file, or a call, has contents that are unknown or contradictory.

    Examples
    --------
    >>> import consistent_id as ci
    >>> ci.PhysicalConsistency(margin=2.0)
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: margin is 2.0, expected a number from 0 ...
    """


class PathError(ProblemError):
    """A robot cannot follow a path; the attributes say where.

    Parameters
    ----------
    reason : str
    arc_length : float, [m]
        From the path's start.
    time : float, [s]
    point : tuple of float, [m]
        Where the path is then, in the base frame.
    joint : str, optional
        Joint whose limit is violated.
    value : float
        The value: a joint's position or rate, a condition number, or the distance [m]
        to the nearest point within reach.

    Examples
    --------
    >>> import consistent_id as ci
    >>> reason = "no pose reaches this point"
    >>> place = dict(arc_length=0.2, time=1.5, point=(0.4, 0.0, 0.9), value=0.05)
    >>> error = ci.PathError(reason, **place)
    >>> error.time, error.point
    (1.5, (0.4, 0.0, 0.9))
    """

    def __init__(
        self,
        reason: str,
        *,
        arc_length: float,
        time: float,
        point: tuple[float, float, float],
        value: float,
        joint: str | None = None,
    ) -> None:
        x, y, z = point
        super().__init__(
            f"{arc_length:.4g} m along the path (t = {time:.4g} s, "
            f"x = {x:.4g}, y = {y:.4g}, z = {z:.4g} m): {reason}"
        )
        self.reason, self.joint, self.value = reason, joint, value
        self.arc_length, self.time, self.point = arc_length, time, point

    def __reduce__(self) -> tuple[Callable[..., "PathError"], tuple[str]]:
        """Let it come back from another process, which keywords alone would not."""
        place = {
            name: getattr(self, name)
            for name in ("arc_length", "time", "point", "value", "joint")
        }
        return partial(PathError, **place), (self.reason,)


class NotExcitedError(ConsistentIdError):
    """The motion carries no information on the required parameters.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> still = ci.Recording(("joint1",), log.time, 0 * q, 0 * q, 0 * q, 0 * q)
    >>> ci.least_squares(model, ci.build_regression(model, still))
    Traceback (most recent call last):
    consistent_id.errors.NotExcitedError: the torque is zero throughout for ...
    """


class InfeasibleError(ConsistentIdError):
    """No parameters satisfy the stated constraints.

    Parameters
    ----------
    reason : str
    members : tuple of int
        Constraints that contradict each other, counted as in `ConicSet.labels` of those
        stated; empty where they were not searched for.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> light = ci.constraints.TotalMass(1.0, 1.5), ci.FixedMasses({"link1": 2.0})
    >>> ci.constrained_least_squares(model, regression, constraints=light)
    Traceback (most recent call last):
    consistent_id.errors.InfeasibleError: no parameters satisfy these ...
    """

    def __init__(self, reason: str = "", members: tuple[int, ...] = ()) -> None:
        super().__init__(reason)
        self.members = members

    def __reduce__(self) -> tuple[Callable[..., "InfeasibleError"], tuple[object, ...]]:
        """Let it come back from another process with its members."""
        return InfeasibleError, (str(self), self.members)


class SolverError(ConsistentIdError):
    """A numerical solver ended without a usable answer.

    Examples
    --------
    >>> import consistent_id as ci
    >>> issubclass(ci.SolverError, ci.ConsistentIdError)
    True
    """
