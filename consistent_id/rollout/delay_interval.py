"""The interval of a delay of commands, for friction that may be of another kind.

Friction that the model lacks shifts the delay with the least error of rollouts by more
than its scatter between blocks of the motion.  So the delay is found again with
friction of other kinds: with a sharper change of sign, with Stribeck friction that
fades at a low and at a higher speed, and with friction that depends on the load.
MuJoCo has none of the last two; in the replays they are a torque over time, computed
from the measured motion, which is near the replayed one.  The interval contains the
intervals of all kinds, with delays far from the best one that are as good.  That of a
delay of 0 is from 0 to its upper limit.  Where rows
of slow joints are left out, friction at low speed does not count; then the other kinds
are other speeds and cut-offs that predict about as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import in_halves
from consistent_id.errors import ConsistentIdError
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.rollout.candidates import Candidates
from consistent_id.rollout.commanded_motion import replayable
from consistent_id.rollout.delay_search import (
    APART,
    NEAR,
    SAME,
    FoundDelay,
    found_delay,
)
from consistent_id.rollout.motion_parts import Spans, within
from consistent_id.rollout.part_errors import BLOCKS_OF_PART, block_squares
from consistent_id.rollout.settings import Settings, compared_fit, with_settings

_SHARPER = 0.25  # times the velocity scale
_FADES = (0.2, 0.5)
"""Speeds at which Stribeck friction fades, over the speed of the motion."""

SPEEDS = (0.02, 0.05, 0.1)
"""Speeds of joints below which their rows may be left out, [rad/s or m/s]."""

ALIKE = 1.25
"""Times the error of the chosen settings, up to which a delay of others counts."""

_STEP = 1.33  # between cut-offs
_FURTHEST = 2.9 * NEAR  # s, beyond which no delay is tried
_LACKING = ("stribeck", "load_friction")  # drive terms that replays do not have


def delay_interval(
    found: FoundDelay,
    others: Sequence[Callable[[float], Vector]],
    most: float,
) -> tuple[float, float] | None:
    """Return the 95 % interval of a delay, by its scatter and by other friction.

    It is wider by `SAME` at both ends: nearer delays are not distinguished.

    Parameters
    ----------
    found : FoundDelay
    others : sequence of callable
        For each kind of friction, the squared errors of blocks of the motion for a
        delay [s], shape (blocks,).
    most : float, [s]
        Longest delay.

    Returns
    -------
    tuple of float, or None, [s]
        None where the delay or one of the others is not known: the squared error has
        no least value between delays that can be tried.
    """
    own = found.interval
    if own is None:
        return None
    around = [found.delay - APART, found.delay, found.delay + APART]
    ends = [own]
    of_kind = partial(found_delay, first=around, most=most, beyond=True)
    for other in in_halves(of_kind, others):
        near = other.at_bound or abs(other.delay - found.delay) < _FURTHEST
        if other.interval is None or not near:
            return None
        ends.append(other.interval)
    low, high = min(low for low, _ in ends), max(high for _, high in ends)
    return max(low - SAME, 0.0), high + SAME


def delay_error(found: FoundDelay, interval: tuple[float, float] | None) -> float:
    """Return the standard error of a delay, from its interval [s].

    By the end that is farther away.  Where the interval is not known, the distance of
    delays that are tried.
    """
    if interval is None:
        return NEAR
    low, high = interval
    return float(f"{max(high - found.delay, found.delay - low) / NORMAL:.3g}")


def delay_words(found: FoundDelay, interval: tuple[float, float] | None) -> str:
    """Return a delay and its interval, or upper limit, in few words."""
    if found.at_bound and found.delay > 0.0:
        return f"delay {1e3 * found.delay:.3g} ms, the longest that is tried"
    if found.at_bound:
        most = "unknown" if interval is None else f"{1e3 * interval[1]:.1f} ms"
        return f"delay 0 (at most{':' * (interval is None)} {most})"
    delay = f"delay {1e3 * found.delay:.2f} ms"
    if interval is None:
        return f"{delay} (error unknown)"
    low, high = (1e3 * end for end in interval)
    return f"{delay} ({low:.1f} to {high:.1f} ms, 95 %)"


def delay_sentence(
    found: FoundDelay, interval: tuple[float, float] | None, *, rested: bool = False
) -> str:
    """Return a delay and its interval with the evidence, or why it has none.

    Parameters
    ----------
    rested : bool
        Whether rows of slow joints are left out, so that friction was not varied.
    """
    other = "other rows of slow joints" if rested else "friction of another kind"
    words = delay_words(found, interval)
    if found.at_bound and found.delay > 0.0:
        return f"{words}: check the clock of commands"
    if interval is None:
        better = "longer ones predict as well" if found.at_bound else "none is best"
        return f"{words}: with {other}, or without a block of the motion, {better}"
    evidence = (
        f"{words}: from the scatter between blocks of the motion, and with {other}; "
        "bodies that are not the robot's may shift it by more"
    )
    if found.at_bound and interval[1] <= SAME:
        evidence += "; commands may be logged later than they act: check their clock"
    return evidence


def damping_sentence(gains: PDGains, joints: Sequence[str]) -> str:
    """Return what viscous friction an error of the delay acts like.

    The torque ``kp (q_d(t - d) - q)`` of late commands is ``kp d dq_d/dt`` less than
    that of commands in time, to first order.
    """
    kp = gains.of(len(joints)).kp
    j = int(np.argmax(kp))
    return (
        f"1 ms more of delay acts like {1e-3 * kp[j]:.2g} more of viscous friction at "
        f"{joints[j]}, its kp times the delay: estimates of both share their errors"
    )


def other_frictions(
    problem: Problem, settings: Settings, candidates: Candidates
) -> list[Callable[[float], Vector]]:
    """Return, for each other kind of friction, the squared errors for a delay [s].

    They are infinite where its motion diverges.  A kind that cannot be built is left
    out, such as friction that depends on the load of unknown bodies.

    Parameters
    ----------
    problem : Problem
        With gains.
    settings : Settings
        Those that were chosen.
    candidates : Candidates
        What was tried.
    """
    if without_rests(problem, settings):
        # Friction that replays lack is not known without rows of slow joints.
        most = ALIKE * candidates.error(settings)
        kinds = _other_rows(problem, settings)
        return [candidates.by_delay(k) for k in kinds if candidates.error(k) <= most]

    def squares(kind: Settings, delay: float) -> Vector:
        made = with_settings(problem, replace(kind, delay=delay))
        try:
            return candidates.weighted(_squares(made, candidates.parts))
        except ConsistentIdError:
            return np.full(2 * BLOCKS_OF_PART, np.inf)

    kinds = [kind for kind in _kinds(problem, settings) if _is_built(problem, kind)]
    return [partial(squares, kind) for kind in kinds]


def without_rests(problem: Problem, settings: Settings) -> bool:
    """Return whether rows of slow joints are left out, by settings or by the file."""
    data = problem.table.data
    stated = None if data is None else data.preparation.least_joint_speed
    return settings.least_joint_speed is not None or stated is not None


def _other_rows(problem: Problem, settings: Settings) -> list[Settings]:
    """Return settings with other rows of slow joints left out, and other cut-offs."""
    own, highest = settings.least_joint_speed, _highest(problem)
    kinds = [replace(settings, least_joint_speed=v) for v in SPEEDS if v != own]
    cutoffs = (settings.cutoff / _STEP, settings.cutoff * _STEP)
    return kinds + [replace(settings, cutoff=c) for c in cutoffs if c < highest]


def _highest(problem: Problem) -> float:
    """Return a cut-off that training logs are too slow for, [Hz]."""
    return 0.4 * min(log.rate for log in problem.logs("training"))


def _kinds(problem: Problem, settings: Settings) -> list[Settings]:
    """Return settings with friction of other kinds."""
    speed = _speed(problem.logs("training"))
    kinds = [replace(settings, velocity_scale=_SHARPER * settings.velocity_scale)]
    kinds += [replace(settings, stribeck_velocity=share * speed) for share in _FADES]
    return [*kinds, replace(settings, load_friction=True)]


def _is_built(problem: Problem, settings: Settings) -> bool:
    try:
        with_settings(problem, settings)
    except ConsistentIdError:
        return False
    return True


def _speed(logs: Sequence[Recording]) -> float:
    """Return the median joint's root-mean-square speed, [rad/s or m/s]."""
    squares = [(velocities(log) ** 2).mean(axis=0) for log in logs]
    return float(np.sqrt(np.median(np.mean(squares, axis=0))))


def _squares(problem: Problem, parts: tuple[Spans, Spans]) -> Matrix:
    """Return squares as `Candidates` do, with friction that MuJoCo lacks as torque."""
    logs, found = problem.logs("training"), []
    for learnt, other in (parts, parts[::-1]):
        estimate, _ = compared_fit(problem, within(problem.training, learnt))
        moved = within(problem.training, other)
        others = [replayable(log) for log in within(logs, other)]
        torques = _lacking(estimate, moved, others)
        found.append(block_squares(problem, estimate, others, torques))
    return np.concatenate(found)


def _lacking(
    estimate: Estimate, moved: Sequence[Recording], logs: Sequence[Recording]
) -> list[Matrix] | None:
    """Return the friction that replays lack at the samples of logs, [N m or N].

    Parameters
    ----------
    moved : sequence of Recording
        The filtered motion of the logs.
    """
    model = estimate.model
    x = np.zeros(len(model.layout))
    for k, (_, name) in enumerate(model.layout.drive, model.layout.inertial_size):
        x[k] = estimate.parameters[k] if name in _LACKING else 0.0
    if not x.any():
        return None
    joints, torques = model.robot.joint_names, []
    for motion, log in zip(moved, logs, strict=True):
        now = motion.of(joints)
        dq, ddq = velocities(now), now.acceleration
        ddq = np.gradient(dq, now.time, axis=0) if ddq is None else ddq
        tau = model.predict(x, now.position, dq, ddq)
        friction = np.zeros((len(log), len(joints)))
        for one, name in zip(tau.T, model.torque_joints, strict=True):
            friction[:, joints.index(name)] = np.interp(log.time, now.time, one)
        torques.append(friction)
    return torques
