"""Robots, limits and motions that designs of trajectories are measured by."""

import json
import os
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

import consistent_id as ci
from consistent_id import signals
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.search_problem import SearchProblem, search_problem
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.motion.proofs.margins import motion_margins
from consistent_id.problems.problem import Problem
from consistent_id.recordings.joint_paths import FourierTrajectory

RATE = 100.0  # Hz, at which every motion is sampled
FRICTION = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
EXAMPLES = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
FINGERS = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
ROOT = Path(__file__).parents[1]

# Neither the paper nor its tables give the RX-60's limits: these are assumptions.
RX60_RANGE = np.deg2rad([160.0, 127.5, 134.5])
RX60_SPEED = np.deg2rad([287.0, 287.0, 319.0])
WRIST = np.array([0.0, -0.31, 0.0])  # in frame 3: d4 of Table I, along y
SIZE = 0.12  # m, of writing tasks; the paper gives none

SERIES = {
    20.0: "ur-20_02_05-20sec_12harm",
    30.0: "ur-20_02_10-30sec_12harm",
    40.0: "ur-20_02_12-40sec_12harm",
    50.0: "ur-20_02_12-50sec_12harm",
}
HARMONICS = 12  # of those recordings
STILL, REST = 0.03, 0.3  # rad/s and s, by which standstill is told


@dataclass(frozen=True)
class Case:
    """A robot, its limits and the form of its paths."""

    name: str
    model: ci.TorqueModel
    limits: MotionLimits
    form: PathForm


@dataclass(frozen=True)
class Recorded:
    """A recorded motion: one period of it, and the series fitted to that."""

    log: ci.Recording
    path: FourierTrajectory
    residual: float  # rad, the largest joint's root mean square


def example(name: str, *, effort: bool = False) -> Case:
    """Return the UR10 or the Panda, 10 s from rest to rest, with the URDF's limits."""
    if name == "UR10":
        robot = ci.robot.load_urdf(EXAMPLES / "ur_description/urdf/ur10_robot.urdf")
    else:
        file = EXAMPLES / "panda_description/urdf/panda.urdf"
        robot = ci.robot.load_urdf(file, locked=FINGERS)
    limits = motion_limits(robot, effort=None if effort else np.inf)
    title = f"{name}, torque limits" if effort else name
    return Case(title, ci.TorqueModel(robot), limits, PathForm(10.0, 5))


def rx60(duration: float = 10.0) -> Case:
    """Return the RX-60's first three joints, from rest to rest, up to 0.5 Hz."""
    model = rx60_problem().model
    ranges = zip(-RX60_RANGE, RX60_RANGE, strict=True)
    position = dict(zip(model.robot.joint_names, ranges, strict=True))
    limits = motion_limits(model.robot, position=position, velocity=RX60_SPEED)
    return Case("RX-60", model, limits, PathForm(duration, round(duration / 2.0)))


def rx60_problem() -> Problem:
    """Return the folder of the paper's robot."""
    return ci.load_problem(ROOT / "problems" / "rx60")


def recordings() -> Path | None:
    """Return the UR10e's folder of recordings, if it is known."""
    folder = os.environ.get("CONSISTENT_ID_DATASETS")
    return Path(folder) / "ur10e" if folder else None


def ur10e(duration: float, *, friction: bool = False) -> Case:
    """Return the UR10e with the limits its recorded motions were designed for."""
    folder = recordings()
    stated = json.loads((folder / "meta.json").read_text())["limits"]
    robot = ci.robot.load_urdf(folder / "ur10e.urdf")
    ranges = zip(stated["q_min_design"], stated["q_max_design"], strict=True)
    limits = motion_limits(
        robot,
        position=dict(zip(robot.joint_names, ranges, strict=True)),
        acceleration=stated["ddq_max_design"],
        effort=np.inf,
    )
    drive = FRICTION if friction else ci.DriveTerms()
    form = PathForm(duration, HARMONICS, rest=False)
    return Case("UR10e", ci.TorqueModel(robot, drive), limits, form)


def recorded(nominal: float) -> Recorded:
    """Return the recorded motion of 12 harmonics and about a duration.

    It is what lies between two standstills; some were played a little slower than
    their name says, and all begin and end at rest, so that a series of 12 harmonics
    does not fit them exactly.
    """
    problem = ci.load_problem(ROOT / "problems" / "ur10e")
    names = problem.model.robot.joint_names
    columns = ci.Columns(
        position="q{number}", velocity="dq{number}", torque="current{number}"
    )
    file = recordings() / "identification" / f"{SERIES[nominal]}.parquet"
    log = problem.prepare(ci.read_recording(file, names, columns))
    still = abs(log.velocity).max(axis=1) < STILL
    edges = np.flatnonzero(np.diff(still.astype(int)))
    # From the end of one rest of a third of a second to the beginning of the next.
    rests = [
        (log.time[a], log.time[b])
        for a, b in zip([0, *edges], [*edges, len(log) - 1], strict=True)
        if still[(a + b) // 2] and log.time[b] - log.time[a] > REST
    ]
    gaps = [(b[0] - a[1], a[1], b[0]) for a, b in pairwise(rests)]
    duration, start, stop = max(gaps)
    part = signals.trimmed(log, start, stop)
    fit = signals.fourier_fit(part, duration, HARMONICS)
    path = replace(fit.trajectory, duration=duration, start=0.0)
    return Recorded(part, path, float(fit.residual.max()))


def torque_noise() -> np.ndarray:
    """Return what least squares leaves of the UR10e's torque [N m]."""
    problem = ci.load_problem(ROOT / "problems" / "ur10e")
    regression = ci.build_regression(problem.model, problem.training)
    estimate = ci.least_squares(problem.model, regression)
    return regression.residual_rms(estimate.parameters)


def condition(case: Case, path: FourierTrajectory, scaling: str = "none") -> float:
    """Return the condition number of a path's base regressor, sampled at 100 Hz."""
    base = ci.regression.base_parameters(case.model)
    aim = Aim(rate=RATE, scaling=scaling)
    return predicted_accuracy(case.model, base, path, aim).condition.value


def condition_of_samples(case: Case, log: ci.Recording, scaling: str = "none") -> float:
    """Return the condition number of recorded samples, in the same columns."""
    base = ci.regression.base_parameters(case.model)
    Y = case.model.regressor(log.position, log.velocity, log.acceleration)
    W = Y[:, list(base.independent)].transpose(0, 2, 1).reshape(-1, len(base))
    return ci.regression.condition_number(
        W, basis="base", unit_columns=scaling == "unit columns"
    ).value


def exceeded(case: Case, path: FourierTrajectory) -> list[str]:
    """Name the limits that a path exceeds, and by which factor."""
    found = []
    for margin in motion_margins(path, case.limits).margins:
        if margin.violated:
            share = margin.reached / margin.limit
            found.append(
                f"{margin.quantity} of {margin.joint} "
                f"({margin.reached:.3g} for {margin.limit:.3g}, {share:.2f} times)"
            )
    return found


def random_path(case: Case, seed: int, share: float = 1.0) -> FourierTrajectory:
    """Return a random path that uses a share of every joint's limits."""
    problem = problem_of(case)
    variables = problem.random(seed)
    largest = problem.limits.largest(variables)
    return problem.basis.trajectory(variables * share / largest)


def problem_of(case: Case) -> SearchProblem:
    """Return a case's search, without limits of torque."""
    base = ci.regression.base_parameters(case.model)
    aim = Aim("condition", rate=RATE)
    return search_problem(case.model, base, case.form, aim, case.limits)


def writing_tasks(duration: float) -> dict[str, FourierTrajectory]:
    """Return writing tasks like the paper's, as series fitted to the joints' motion.

    The wrist draws a level circle, an upright ellipse and a helix about a point in
    front of the arm, once in `duration`, at even speed of the angle.
    """
    angle = 2.0 * np.pi * np.arange(400) / 400.0
    circle = np.array([np.cos(angle), np.sin(angle), 0.0 * angle])
    ellipse = np.array([0.0 * angle, np.cos(angle), 0.5 * np.sin(angle)])
    # Up and down once while three turns are drawn: a helix that closes.
    helix = np.array([np.cos(3 * angle), np.sin(3 * angle), np.cos(angle)])
    shapes = {"a circle": circle, "an ellipse": ellipse, "a helix": helix}
    return {
        name: _drawn(np.array([0.4, 0.05, 0.25]) + SIZE * shape.T, duration)
        for name, shape in shapes.items()
    }


def _drawn(points: np.ndarray, duration: float) -> FourierTrajectory:
    robot = rx60_problem().model.robot
    q, positions = np.array([0.0, -0.3, -1.0]), []
    for point in points:
        found = least_squares(lambda q, p=point: _wrist(robot, q) - p, q, xtol=1e-12)
        if found.cost > 1e-12:
            raise RuntimeError(f"the arm does not reach {point}")
        q = found.x
        positions.append(q)
    time = duration * np.arange(len(points)) / len(points)
    log = ci.Recording(robot.joint_names, time, np.array(positions))
    fitted = signals.fourier_fit(log, duration, 12).trajectory
    return replace(fitted, duration=duration)


def _wrist(robot: ci.RobotModel, q: np.ndarray) -> np.ndarray:
    place = WRIST
    for joint, angle in zip(reversed(robot.joints), reversed(q), strict=True):
        turn = pin.utils.rotate("z", angle)  # all joints turn about z
        place = joint.rotation @ turn @ place + joint.translation
    return place
