"""Causes that a log suggests: gravity, masses, a load, gains, clock, channel order.

Gravity may point in another direction than the model's, because the base leans.  A load
that the model lacks is a last link with unknown parameters: its mass is that of the
model or more, its other nine parameters are free, and the other links stay as known.
Other masses of all links explain such a log as well, but the load changes less.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.constraints import (
    Constraint,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    MassBounds,
)
from consistent_id.diagnosis.channel_factors import ChannelFactors, channel_factors
from consistent_id.diagnosis.contact_stretches import contact
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import (
    LOAD,
    SAMPLES,
    Candidate,
    FittedLog,
    thinned,
)
from consistent_id.diagnosis.factor_logs import (
    FactorLogs,
    factor_system,
    factors_of,
    leaning,
)
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import RANK
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.diagnosis.torque_causes import late_torque, lost_signs, missing_parts
from consistent_id.diagnosis.torque_parts import (
    TorqueParts,
    friction_shapes,
    nominal_parts,
    torque_parts,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.base import base_parameters
from consistent_id.regression.friction_shapes import shapes_of, with_shapes
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import last_links
from consistent_id.robot.model import RobotModel
from consistent_id.robot.scaling import placeholders, reference_bodies

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_EXPLAINED = 0.03  # of the torque: misfit below which gain and clock are not tried
# Ratio of misfits for the clock.  Its speed also changes the velocity scale of Coulomb
# friction, which gives clean logs a ratio of up to 1.45.
_OF_TIME = 1.6
_GAINS = (1e-3, 0.01, 0.4, 0.55, 0.7, 0.85, 1.2, 1.4, 1.8, 2.5, 100.0, 1e3)
_EDGES = ("velocity_scale", "stribeck_velocity")  # shapes of friction that are speeds
_SPEEDS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.4, 2.0, 2.8, 5.0, 10.0)


def alternatives(as_is: FittedLog) -> list[Candidate]:
    """Return the causes that a log suggests."""
    return [
        *other_gravity(as_is),
        *_other_masses(as_is),
        *other_loads(as_is),
        *_other_channels(as_is),
        *lost_signs(as_is),
        *_other_gain(as_is),
        *_other_clock(as_is),
        *late_torque(as_is),
        *missing_parts(as_is),
        *contact(as_is),
    ]


def _other_masses(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with unknown masses.

    A gain on all torques has the same effect as a factor on all masses.
    """
    free = [c for c in as_is.constraints if not isinstance(c, FixedMasses)]
    if len(free) == len(as_is.constraints):
        return
    cause = Cause(
        "masses or gain",
        "all joints",
        "with other masses than the model's, or a gain on all torques",
        'check load, tool, model and gains; if these are right, masses = "free" '
        "(--masses free)",
        _THRESHOLD,
        excuse=1,
    )
    yield Candidate(cause, as_is.factors, free)


def _other_gain(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with another factor for the torque that fits best with one.

    Several joints carry one body, so their torques must agree.
    """
    factors = as_is.factors
    everyone, names = factors.model.robot.joint_names, factors.model.torque_joints
    if as_is.misfit < _EXPLAINED or len(names) < 2:
        return  # with one torque any gain fits equally well

    def changed(name: str, logarithm: float) -> ChannelFactors:
        scale = np.ones(len(everyone))
        scale[everyone.index(name)] = np.exp(logarithm)
        return factors.changed(np.diag(scale))

    tried = factors.least_misfits(_GAINS)
    j, k = np.unravel_index(np.argmin(tried), tried.shape)
    name, start = names[j], float(np.log(_GAINS[k]))
    if tried[j, k] * _THRESHOLD > factors.least_misfit():
        return
    from scipy.optimize import minimize_scalar  # its import takes longer than the rest

    near = minimize_scalar(
        lambda logarithm: changed(name, logarithm).least_misfit(),
        bounds=(start - 0.4, start + 0.4),
        method="bounded",
        options={"xatol": 0.005},
    )
    factor = float(np.exp(near.x))
    cause = Cause(
        "torque gain",
        name,
        f"with the torque of {name} times {factor:.3g}",
        f"check the gain and gear ratio of {name}",
        _THRESHOLD,
    )
    yield Candidate(cause, changed(name, float(near.x)), as_is.constraints)


def _other_clock(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the clock's speed that fits best.

    Gravity torque does not depend on the clock, but inertial torque does.  So do the
    velocities at which friction changes: a model that has them wrong is no wrong clock,
    and explains the log as well with these velocities alone changed.
    """
    if as_is.misfit < _EXPLAINED:
        return
    model, base = as_is.factors.model, as_is.factors.base
    screen = as_is.screen

    def left(speeds: Sequence[float]) -> list[float]:
        logs = [_at_speed(screen.few, speed) for speed in speeds]
        return screen.least_misfits(model, base, logs)

    tried = left(_SPEEDS)
    k = int(np.argmin(tried))
    if k in (0, len(tried) - 1) or _SPEEDS[k] == 1.0:
        return  # at the ends the torque is all gravity, or all inertia
    if min(tried) * _OF_TIME > tried[_SPEEDS.index(1.0)]:
        return
    others = (_with_edges(model, speed) for speed in _SPEEDS)
    edges = [screen.least_misfits(other, base, [screen.few])[0] for other in others]
    if min(tried) * _OF_TIME > min(edges):
        return
    from scipy.optimize import minimize_scalar

    inner = np.log(_SPEEDS)[[k - 1, k + 1]]
    best = minimize_scalar(
        lambda size: left([float(np.exp(size))])[0], bounds=inner, method="bounded"
    )
    speed = float(np.exp(best.x))
    cause = Cause(
        "clock",
        "time",
        f"with a clock {speed:.3g} times as fast",
        f"divide the time by {speed:.3g}: find out its unit, or the rate of the log",
        _OF_TIME,
    )
    (factors,) = channel_factors(model, base, [_at_speed(as_is.recording, speed)])
    yield Candidate(cause, factors, as_is.constraints)


def _with_edges(model: TorqueModel, speed: float) -> TorqueModel:
    """Return a model whose friction changes with velocity as a faster clock makes it.

    Bounds of shapes are where they may be fitted; here they need not be kept.
    """
    shapes = {s.name: s.value / speed for s in shapes_of(model) if s.kind in _EDGES}
    return with_shapes(model, shapes)


def _at_speed(log: Recording, speed: float) -> Recording:
    """Return a prepared recording with a faster clock."""

    def faster(raw: Recording) -> Recording:
        rates = np.asarray(raw.velocity), np.asarray(raw.acceleration)
        velocity, acceleration = speed * rates[0], speed**2 * rates[1]
        return replace(raw, velocity=velocity, acceleration=acceleration)

    return altered(log, faster)


def _other_channels(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the order of torque channels in which the rows of joints fit best."""
    factors = as_is.factors
    names = factors.model.torque_joints
    if len(names) < 3:
        return
    costs = np.array([_row_misfits(F, len(factors.base)) for F in factors.factors])
    if (costs.argmin(axis=1) == np.arange(len(names))).all():
        return  # each row fits its own channel best
    order = _cheapest_order(np.log(np.maximum(costs, 1e-9)))
    if (order == np.arange(len(order))).sum() >= len(order) - 2:
        return  # two exchanged channels are in the table of corrections
    everyone = factors.model.robot.joint_names
    matrix = np.eye(len(everyone))
    places = [everyone.index(name) for name in names]
    matrix[np.ix_(places, places)] = np.eye(len(names))[:, order]
    meant = ", ".join(names[k] for k in order)
    cause = Cause(
        "channel order",
        "all joints",
        f"with the torques of {', '.join(names)} taken from the columns of {meant}",
        "name the torque columns in the order of the joints they belong to",
        _THRESHOLD,
    )
    yield Candidate(cause, factors.changed(matrix), as_is.constraints)


def _cheapest_order(costs: Matrix) -> IntArray:
    """Return a different column for each row, with the least sum of costs."""
    # The import of scipy.optimize takes .13 s, that of this .02 s.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    # A cost of zero would be no edge; of equal ones, each row's own column is taken.
    edges = csr_array(costs - costs.min() + 1.0 - 1e-9 * np.eye(len(costs)))
    _, order = min_weight_full_bipartite_matching(edges)
    return np.asarray(order, dtype=np.intp)


def _row_misfits(factor: Matrix, base: int) -> Vector:
    """Return the misfit of a joint's row to each torque channel, relative to it."""
    columns, channels = factor[:, :base], factor[:, base:]
    norms = np.linalg.norm(columns, axis=0)  # zero of values whose squares underflow
    Q, _ = np.linalg.qr(columns[:, norms > 0.0] / norms[norms > 0.0])
    left = channels - Q @ (Q.T @ channels)
    size = np.maximum(np.linalg.norm(channels, axis=0), 1e-300)
    return np.asarray(np.linalg.norm(left, axis=0) / size)


# Ratio of the nominal robot's misfits, upright and leaning.  Turning gravity also
# explains a part of the errors of nominal bodies.
_CLEARLY = 1.5
_TURNED = np.radians(5.0)  # less may be a floor that is not level
_NEAR = np.radians(20.0)  # farther, what settles is no error of nominal bodies
_TURNS = 3
_G = (0.7, 1.4)  # ratio of sizes within which an estimated vector is gravity
_TURN_BASE = (
    "turn the base or gravity in the model as the robot is mounted; or check "
    "the zero offset of the first joint, if its axis is level"
)


def other_gravity(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the direction of gravity that fits the nominal bodies."""
    model = as_is.factors.model
    turned = turned_gravity(model, as_is.recording)
    if turned is None:
        return
    cause = Cause(
        "gravity", "base", f"with {_words(model, turned)}", _TURN_BASE, _THRESHOLD
    )
    other = _with_gravity(model, turned)
    (factors,) = channel_factors(other, base_parameters(other), [as_is.recording])
    yield Candidate(cause, factors, as_is.constraints)


def leaning_findings(
    model: TorqueModel, prepared: Recording, upright: TorqueParts
) -> list[LogFinding]:
    """Find a leaning base: the nominal robot explains the log only if it leans.

    A leaning base scales the gravity torque of upright joints, as a gain does.

    Parameters
    ----------
    upright : TorqueParts
        Parts of the model without leaning.
    """
    turned = turned_gravity(model, prepared)
    if turned is None:
        return []
    other = _with_gravity(model, turned)
    leaning = torque_parts(other, prepared)
    before, after = float(np.median(upright.rest)), float(np.median(leaning.rest))
    if before < _CLEARLY * after:
        return []
    return [
        LogFinding(
            "gravity",
            "fault",
            "base",
            f"with {_words(model, turned)}, the nominal robot and friction leave "
            f"{after:.1%} of each joint's torque unexplained (median over joints); as "
            f"it is, {before:.1%}",
            _TURN_BASE,
            before / max(_CLEARLY * after, 1e-12),
        )
    ]


def turned_gravity(model: TorqueModel, recording: Recording) -> Vector | None:
    """Return the log's gravity [m/s^2]; None if it is the model's, or not gravity."""
    robot = model.robot
    size = float(np.linalg.norm(robot.gravity))
    if robot.nominal is None or size == 0.0:
        return None
    gravity = gravity_in(model, recording)
    length = float(np.linalg.norm(gravity))
    if not _G[0] <= length / size <= _G[1]:
        return None
    turned = gravity * size / length
    if _angle(model, turned) < _TURNED:
        return None
    settled = _settled(model, recording, turned)
    near = _angle(_with_gravity(model, settled), turned) <= _NEAR
    return settled if near else turned


def _settled(model: TorqueModel, recording: Recording, gravity: Vector) -> Vector:
    """Return the gravity near another one that is likely once bodies are free.

    Errors of nominal bodies turn the one that fits them by some degrees.  Bodies and
    friction are estimated together with a turn about two level axes, several times:
    the effect of a turn is not linear, and without it the noise is less.
    """
    turned = _with_gravity(model, gravity)
    for _ in range(_TURNS):
        state = FactorLogs.of(turned, [thinned(recording, SAMPLES)])
        level = [f for f in factors_of(turned) if f.kind == "gravity"]
        system = factor_system(state, level, scatter=False)
        turn = system.solution([*range(len(level))]) @ np.array([f.axis for f in level])
        size = float(np.linalg.norm(turn))
        if size == 0.0:
            break
        turned = leaning(turned, tuple(turn / size), min(size, _NEAR))
    return np.asarray(turned.robot.gravity)


def _with_gravity(model: TorqueModel, gravity: Vector) -> TorqueModel:
    return replace(model, robot=replace(model.robot, gravity=gravity))


def _angle(model: TorqueModel, gravity: Vector) -> float:
    """Return the angle between a gravity and the model's [rad]."""
    own = np.asarray(model.robot.gravity)
    cosine = float(gravity @ own) / float(np.linalg.norm(gravity) * np.linalg.norm(own))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _words(model: TorqueModel, turned: Vector) -> str:
    text = ", ".join(f"{np.round(g, 2) + 0.0:.2f}" for g in turned)  # not -0.00
    degrees = np.degrees(_angle(model, turned))
    return (
        f"gravity along ({text}) m/s^2 (--gravity {text.replace(',', '')}), "
        f"{degrees:.0f} degrees from the model's"
    )


def gravity_in(model: TorqueModel, recording: Recording) -> Vector:
    """Return the gravity with which the nominal bodies fit a log best, [m/s^2].

    The torque is linear in it: three unknowns, beside friction and the inertial torque
    of each joint.
    """
    robot, log = model.robot, SampleRows.of(model, recording)
    bodies = reference_bodies(robot).ravel()
    rows = model.torque_joints
    turned = (
        TorqueModel(replace(robot, gravity=axis), torque_joints=rows)
        for axis in np.eye(3)
    )
    state = log.along.q, None, None
    unit = np.stack([one.rigid_torque(bodies, state).T for one in turned], axis=1)
    _, inertial = nominal_parts(log)
    others = np.concatenate([inertial.T[:, None], friction_shapes(log)], axis=1)
    pairs = zip(log.filtered(unit), log.filtered(others), strict=True)
    left, right = [], []
    for (along_axes, own), tau in zip(pairs, log.torque, strict=True):
        Q, _ = np.linalg.qr(own.T)
        seen = along_axes.T
        scale = float(np.sqrt(np.mean(tau**2))) or 1.0
        left.append((seen - Q @ (Q.T @ seen)) / scale)
        right.append((tau - Q @ (Q.T @ tau)) / scale)
    return smallest_solution(np.vstack(left), np.concatenate(right), RANK)


_HEAVIEST = 1e4  # kg: no robot carries more
_ADD_LOAD = (
    "add the load or tool of {link} to the model, or remove it from the robot; "
    "identify_payload finds its ten parameters from logs with it and without it; if "
    'the masses of the model are placeholders, masses = "free" (--masses free)'
)


def other_loads(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with an unknown last link, for each last link.

    A model with placeholders has no known links, so that none is tried.
    """
    robot = as_is.factors.model.robot
    if placeholders(robot):
        return
    for link in last_links(robot):
        free = without_link(as_is.constraints, robot, link.name)
        if free is None:
            continue
        if link.datasheet.mass is not None:
            free.append(MassBounds({link.name: (link.datasheet.mass, _HEAVIEST)}))
        cause = Cause(
            LOAD,
            link.name,
            f"with another load at {link.name} than the model's",
            _ADD_LOAD.format(link=link.name),
            _THRESHOLD,
            excuse=1,
        )
        yield Candidate(cause, as_is.factors, free)


def without_link(
    constraints: Sequence[Constraint], robot: RobotModel, link: str
) -> list[Constraint] | None:
    """Return constraints without a link; None if none of them concerns it."""
    found: list[Constraint] = []
    for constraint in constraints:
        others = _without(constraint, robot, link)
        found += [] if others is None else [others]
    return None if found == list(constraints) else found


def _without(constraint: Constraint, robot: RobotModel, link: str) -> Constraint | None:
    """Return a constraint without a link; None if nothing is left of it."""
    if isinstance(constraint, FixedMasses):
        sheet = {each.name: each.datasheet.mass for each in robot.links}
        masses = sheet if constraint.masses is None else constraint.masses
        known = {k: m for k, m in masses.items() if m is not None and k != link}
        unchanged = constraint.masses is not None and link not in constraint.masses
        return constraint if unchanged else (FixedMasses(known) if known else None)
    if isinstance(constraint, FixedCentresOfMass):
        places = {each.name: each.datasheet.com for each in robot.links}
        centres = places if constraint.centres is None else constraint.centres
        left = {k: list(c) for k, c in centres.items() if c is not None and k != link}
        unchanged = constraint.centres is not None and link not in constraint.centres
        return constraint if unchanged else (FixedCentresOfMass(left) if left else None)
    if isinstance(constraint, FixedBodies):
        bodies = tuple(n for n in constraint.links or robot.link_names if n != link)
        unchanged = bool(constraint.links) and link not in constraint.links
        return constraint if unchanged else (FixedBodies(bodies) if bodies else None)
    return constraint
