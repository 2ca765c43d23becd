"""Intervals of factors of a whole robot, foot radii, fleets, blocks, designs.

See `coverage_methods`.

Each function yields errors over standard errors, one array for each log.  Where 95 %
intervals are wider than 1.96 standard errors, so are these.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from coverage_arm import LEVEL, arm, motion
from coverage_raw import Preparation, standing
from known_arm import logged
from quadrupeds import CORNERS, FEET, FOOT, quadruped_text
from walking import Walk, walked

import consistent_id as ci
from consistent_id.diagnosis.factor_logs import LEAN, FactorLogs, factors_of, gain_of
from consistent_id.diagnosis.factor_rows import Factor
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.diagnosis.whole_robot import gain_beside_bodies, whole_robot_factors
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.estimation.uncertainties.block_scatter import (
    BLOCKS,
    BlockScatter,
    block_scatter,
)
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.regression.residual_noise import joint_noise, unconstrained_fit
from consistent_id.regression.segments import segment_regressions
from consistent_id.robot.scaling import USUAL_WIDTHS, body_sizes, link_scales
from consistent_id.standing.forces_and_limits import StandingLimits, standing_motion
from consistent_id.standing.stance import Stance, StandingFoot
from consistent_id.standing.standing_design import REST, trunk_errors
from consistent_id.standing.trunk_path import TrunkPath

Noise = Callable[[tuple[int, int], np.random.Generator], np.ndarray]
NORMAL = 1.96
ZERO = np.radians(15.0)  # by which the position of one joint is off
RADIUS, WORN = 0.02, 4e-4  # m, of feet, and what is worn off
TORQUE = 0.05  # N m, noise of a quadruped's joints
SECONDS = 12.0  # of its walk
ROBOTS = 4  # of a fleet
BRICK = ci.InertialParameters.from_central(
    1.5, (0.1, 0.05, -0.02), np.diag([0.01, 0.02, 0.015])
)
TOOL = ci.InertialParameters.from_central(
    1.3, [0.02, -0.01, 0.08], [[4e-3, 1e-4, 0], [1e-4, 3e-3, 2e-4], [0, 2e-4, 2e-3]]
)
SENSOR = np.array([0.2] * 3 + [0.02] * 3)  # N, N m: noise of a wrist sensor
POSE = np.tile([0.1, 0.2, -0.9], 4)  # of a quadruped, rad


def zeros(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the zero of a joint, bodies being drawn as they are known."""
    yield from _of_factors(
        noise, replicates, lambda model, k: zero_of(model, 1 + k % 2)
    )


def factors_of_all(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the clock, the gain of all joints, and the lean of the base."""
    base = Factor("gravity", "base", LEAN, axis=(1.0, 0.0, 0.0))
    for sought in ("clock", "masses or gain", base):
        yield from _of_factors(
            noise,
            max(replicates // 3, 1),
            lambda model, _, of=sought: factor(model, of),
        )


def single_gains(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the gain of one joint."""
    yield from _of_factors(
        noise,
        replicates,
        lambda model, k: gain_of(model, model.torque_joints[1 + k % 2]),
    )


def slopes(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of slopes on nominal gravity and inertial torque that are judged.

    Bodies are nominal ones, so that slopes are one.  There are several in a log.
    """
    rng = np.random.default_rng(17)
    for k in range(replicates):
        model, log = logged(k, noise=0.0)
        if k == 0:
            prepared = Preparation(model, log)
        parts = torque_parts(model, prepared(log, shake(noise, log, rng), rng))
        for slope, error, shown in (
            (parts.gravity, parts.gravity_error, parts.gravity_shown),
            (parts.inertial, parts.inertial_error, parts.inertial_shown),
        ):
            yield from ((slope - 1.0) / error)[shown][:, None]


def zero_of(model: ci.TorqueModel, joint: int) -> Factor:
    """Return the factor of a joint's zero."""
    zeros_of = (f for f in factors_of(model) if f.kind == "offset zero")
    return next(f for f in zeros_of if f.joint == joint)


def factor(model: ci.TorqueModel, sought: str | Factor) -> Factor:
    """Return a factor of the whole robot by its kind."""
    if isinstance(sought, Factor):
        return sought
    return next(f for f in factors_of(model) if f.kind == sought)


SIZES = {
    "offset zero": ZERO,
    "gravity": np.radians(12.0),
    "clock": np.log(1.4),
    "masses or gain": np.log(1.4),
    "torque gain": np.log(1.4),
}


def _of_factors(
    noise: Noise,
    replicates: int,
    chosen: Callable[[ci.TorqueModel, int], Factor],
) -> Iterator[np.ndarray]:
    """Yield errors of a factor that is put into logs of robots with other bodies.

    Bodies differ from nominal ones as far as bodies are usually known.  A factor that
    is not reported is left out.
    """
    rng = np.random.default_rng(9)
    for k in range(replicates):
        model, log = logged(k, noise=0.0)
        if k == 0:
            prepared = Preparation(model, log)
        log = ci.simulate_torque(model, _drawn(model, rng), log)
        added = shake(noise, log, rng)
        put_in = chosen(model, k)
        size = SIZES[put_in.kind]
        spoilt = FactorLogs.of(model, [log]).without(put_in, -size)
        (wrong,) = spoilt.logs
        if put_in.kind == "clock":
            wrong = replace(wrong, time=np.exp(size) * wrong.time)
        raw = prepared(wrong, added, rng)
        as_is = FactorLogs.of(spoilt.model, [raw], masses_known=True)
        if put_in.kind == "torque gain":
            alone = gain_beside_bodies(as_is, put_in.where)
            found = [] if alone is None else [alone]
        else:
            found = whole_robot_factors(as_is)
        for one in found:
            if (one.factor.kind, one.factor.joint) == (put_in.kind, put_in.joint):
                # The axis of a lean is found, too, and may point the other way.
                seen = abs(one.size) if put_in.kind == "gravity" else one.size
                yield np.array([(seen - size) / one.error])


def shake(noise: Noise, log: ci.Recording, rng: np.random.Generator) -> np.ndarray:
    """Return noise of `LEVEL` of a log's torques."""
    return LEVEL * log.torque.std(axis=0) * noise(log.torque.shape, rng)


def _drawn(model: ci.TorqueModel, rng: np.random.Generator) -> np.ndarray:
    """Return parameters of a robot whose bodies differ from the nominal ones."""
    mass, centre, moment = USUAL_WIDTHS
    m, d = link_scales(model.robot).mass, body_sizes(model.robot)
    widths = [mass * m, *[centre * m * d] * 3, *[moment * m * d**2] * 6]
    width = np.column_stack(widths).ravel()
    bodies = model.robot.nominal + width * rng.normal(size=len(width))
    return np.append(bodies, np.tile([1.0, 2.0, 0.3], len(model.robot)))


@cache
def quadruped() -> ci.RobotModel:
    """Return a robot with a trunk and four legs."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "quadruped.xml"
        file.write_text(quadruped_text(hips=CORNERS))
        return ci.robot.load_mjcf(file, base="floating")


def radii(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the radius of round feet, and of a walking robot's bodies.

    The radius is stated larger than it is; all bodies but the trunk are known.
    """
    robot = quadruped()
    moved = walked(robot, robot.nominal, seconds=SECONDS, radius=RADIUS - WORN)
    clean = as_recording(robot, moved, RADIUS)
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    values = dict(zip(model.layout.names[10:], robot.nominal[10:], strict=True))
    known = [ci.constraints.FixedParameters(values)]
    rng = np.random.default_rng(10)
    for _ in range(replicates):
        log = standing(clean, TORQUE * noise(clean.torque.shape, rng), rng)
        found = ci.estimation.contact_radius(model, log, constraints=known)
        yield np.array([NORMAL * (found.offset + WORN) / found.half_width])


def as_recording(robot: ci.RobotModel, moved: Walk, radius: float) -> ci.Recording:
    """Return a walk at half its rate as a recording."""
    log = ci.Recording(
        robot.joint_names,
        moved.time,
        moved.q,
        moved.dq,
        moved.ddq,
        moved.torque,
        base=moved.base,
        contacts=tuple(
            ci.recordings.ContactFlags(foot, moved.closed[:, i], FOOT, radius=radius)
            for i, foot in enumerate(FEET)
        ),
    )
    return log.samples(slice(None, None, 2))


def walks(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of base parameters of a robot on its feet, whose forces are free."""
    robot = quadruped()
    clean = as_recording(robot, walked(robot, robot.nominal, seconds=SECONDS), 0.0)
    model = ci.TorqueModel(robot)
    base = ci.regression.base_parameters(model)
    true = base.projection @ robot.nominal
    rng = np.random.default_rng(11)
    for _ in range(replicates):
        log = standing(clean, TORQUE * noise(clean.torque.shape, rng), rng)
        regression = ci.build_regression(model, log)
        found = ci.least_squares(model, regression, base=base)
        widths = NORMAL / unconstrained_fit(regression, base).noise.quantiles
        yield widths * (found.base_values - true) / found.standard_errors


def fleets(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of bodies that robots share, and of what one of them carries.

    Bodies are base parameters by least squares.
    """
    for bodies, payload in of_fleets(noise, replicates):
        yield np.append(bodies, payload)


def of_fleets(noise: Noise, replicates: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    model, truth = arm(3)
    rng = np.random.default_rng(12)
    states = [moved(motion(model), rng) for _ in range(ROBOTS)]
    link = model.robot.links[-1].name
    loaded = truth.copy()
    loaded[20:30] += BRICK.vector
    first = ci.simulate_torque(model, truth, states[0])
    prepared = Preparation(model, first)
    for _ in range(replicates):
        regressions = {}
        for k, path in enumerate(states):
            x = (loaded if k == ROBOTS - 1 else truth).copy()
            x[30:] *= rng.uniform(0.5, 1.5, len(x) - 30)
            log = ci.simulate_torque(model, x, path)
            log = prepared(log, shake(noise, log, rng), rng)
            regressions[f"robot{k}"] = ci.build_regression(model, log)
        fleet = ci.fleet.fleet_estimate(
            model,
            regressions,
            payloads={f"robot{ROBOTS - 1}": ci.fleet.CarriedBody(link)},
        )
        bodies, one = fleet.bodies, fleet.robots[-1].payload
        errors, known = bodies.parameter_errors, one.standard_errors
        off = bodies.parameters - truth[:30]
        kept = np.isfinite(errors) & (errors > 0.0)
        told = np.isfinite(known)
        yield (
            off[kept] / errors[kept],
            (one.body.vector - BRICK.vector)[told] / known[told],
        )


def moved(states: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    """Return half of a motion, from another moment on, in ten seconds' periods."""
    first = int(rng.integers(0, len(states) // 3))
    part = states.samples(slice(first, first + len(states) // 2))
    return replace(part, time=part.time - part.time[0])


def blocks(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of drives' parameters with scatter between blocks, bodies known.

    The first half are those of all blocks beside the truth, the others those of one
    block of other motion beside the values from all.
    """
    model, truth = arm(3)
    names = model.layout.names
    known = [ci.constraints.FixedParameters(dict(zip(names[:30], truth, strict=False)))]
    clean = ci.simulate_torque(model, truth, motion(model))
    rng, prepared = np.random.default_rng(13), Preparation(model, clean)
    first = round(len(clean) * BLOCKS / (BLOCKS + 1))
    for _ in range(replicates):
        whole = prepared(clean, shake(noise, clean, rng), rng)
        log, later = whole.samples(slice(0, first)), whole.samples(slice(first, None))
        sigma = joint_noise(model, ci.build_regression(model, log))
        parts = segment_regressions(model, log, count=BLOCKS, sigma=sigma)
        one = ci.build_regression(model, later)
        one = one.weighted(joint_noise(model, one))
        found = block_scatter(model, parts, constraints=known)
        other = block_scatter(model, [one], constraints=known)
        yield np.append(*over_intervals(found, other, truth[30:]))


def over_intervals(
    found: BlockScatter, other: BlockScatter, truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return errors in intervals of 95 %, divided by 1.96."""
    return (
        NORMAL * (found.values - truth) / (found.quantiles * found.standard_errors),
        NORMAL * (found.values - other.values) / found.widths_for(other),
    )


def standing_designs(
    noise: Noise, replicates: int, *, correlation: float = 1.0
) -> Iterator[np.ndarray]:
    """Yield errors of a trunk over those predicted for its motion on feet.

    Noise that is correlated over some samples is stated as white at a lower rate.
    """
    robot, rng = quadruped(), np.random.default_rng(14)
    point = np.array([FOOT])
    feet = tuple(StandingFoot(foot, point, False) for foot in FEET)
    stance = Stance(robot, feet, POSE)
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    model = ci.TorqueModel(robot, drive)
    sizes = 0.5 * np.array([0.02] * 3 + [0.08] * 3)
    tones = np.random.default_rng(0).normal(size=(2, 3, 6))
    path = TrunkPath([0.4, 0.9, 1.7], sizes * tones / np.arange(1, 4)[:, None], 10.0)
    time = np.arange(1000) / 100.0
    moved = standing_motion(stance, StandingLimits(), path, time)
    predicted = trunk_errors(stance, model, moved, 100.0 / correlation)
    clean = ci.Recording(
        robot.joint_names,
        time,
        moved.joints.q,
        moved.joints.dq,
        moved.joints.ddq,
        moved.ground.torque,
        base=moved.trunk.base,
        contacts=stance.contacts(len(time)),
        torque_known=abs(moved.joints.dq) > REST,
    )
    free = ci.regression.contact_free_model(model)
    bodies = dict(zip(model.layout.names, robot.nominal, strict=False))
    legs = {n: x for n, x in bodies.items() if not n.startswith("trunk.")}
    known = FreeParameters.of([ci.constraints.FixedParameters(legs)], free)
    for _ in range(replicates):
        log = replace(clean, torque=clean.torque + noise(clean.torque.shape, rng))
        (R,) = ci.regression.contact_free_regression(free, log).factors
        step = least_squares(*known.reduced(R[:, :-1], R[:, -1]))
        found = known.start + known.directions @ step
        yield (found[:10] - robot.nominal[:10]) / predicted


def sensor_designs(
    noise: Noise, replicates: int, *, correlation: float = 1.0
) -> Iterator[np.ndarray]:
    """Yield errors of a tool over those predicted for its motion on a wrist sensor.

    The aim states the time over which noise is correlated; zero is white noise.
    """
    arm_model, _ = arm(6)
    robot, rng = arm_model.robot, np.random.default_rng(15)
    tip = robot.links[-1].name
    rows = ci.regression.SensorRows(ci.regression.tool_model("tool"), robot, tip)
    path = random_path(robot)
    log = path.recording(rate=100.0)
    base = ci.regression.base_parameters(rows.tool)
    time = correlation / 100.0 if correlation > 1.0 else 0.0
    aim = ci.Aim(noise=SENSOR, correlation_time=time, rate=100.0)
    predicted = predicted_accuracy(rows, base, path, aim).standard_errors()
    still = np.zeros((len(log), 0))
    moving = ci.regression.sensor_motion(robot, log, tip)
    truth = np.append(TOOL.vector, np.zeros(6))
    clean = rows.tool.predict(truth, still, still, still, base=moving)
    for _ in range(replicates):
        seen = clean + SENSOR * noise(clean.shape, rng)
        shown = replace(log, wrenches=(ci.recordings.Wrench(tip, seen),))
        rows_of = ci.regression.sensor_regression(rows.tool, robot, shown, frame=tip)
        found = ci.least_squares(rows.tool, rows_of.weighted(SENSOR), base=base)
        yield (found.base_values - base.projection @ truth) / predicted


def random_path(robot: ci.RobotModel) -> ci.recordings.FourierTrajectory:
    """Return a path of ten seconds with random coefficients."""
    sizes = np.random.default_rng(1).normal(size=(2, 5, len(robot)))
    sizes *= 0.5 / np.arange(1, 6)[:, None]
    still = np.zeros(len(robot))
    return ci.recordings.FourierTrajectory(
        robot.joint_names, np.arange(1, 6) / 10.0, still, *sizes, 10.0
    )
