"""Contacts: touches of a resting arm, torque steps on a moving one, place and force.

``python benchmarks/contacts.py [--only touches steps place rate]
[--write docs/touch.md]``

Thresholds come from other logs than those that they are tried on.  Touches: a Franka
arm that holds a pose and is touched by hand, labelled by a glove.  Steps: torque steps
added to logs of a moving UR10e, whose model is identified from the other logs.  Place:
forces of known size and place on a simulated arm, with the noise of the Franka's logs.
Rate: false alarms in hours of simulated arms, which have friction that the model lacks.
"""

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
from faults_robots import Robot, as_drawn, loaded, urdf
from pages import written_to
from payload import ARMS, run_of, states

import consistent_id as ci
from consistent_id.recordings import Recording
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.robot.kinematics import link_places
from consistent_id.service import (
    ContactDetector,
    ControlModel,
    MomentumObserver,
    control_model,
)

DATA = Path(os.environ["CONSISTENT_ID_DATASETS"])
REST = 0.4  # s without a touch before those that count, and before rest that counts
SETTLED = 0.25  # s after a touch, in which the hand may still be there
EARLY = 0.05  # s before a label, in which the hand may be there already
ALLOWED = 1e-3  # share of false samples that is allowed to the vendor's torque

UR10E = (
    "identification/ur-20_02_05-20sec_12harm",
    "identification/ur-20_02_06-20sec_10harm",
    "identification/ur-20_02_06-20sec_5harm",
    "identification/ur-20_02_10-20sec_7harm",
    "identification/ur-20_02_10-30sec_12harm",
    "identification/ur-20_02_12-40sec_12harm",
    "identification/ur-20_02_12-50sec_12harm",
    "identification/ur-20_02_19_14harm50sec",
    "identification/ur-20_02_19_15harm50sec",
    "validation/ur-20_02_05-20sec_8harm",
)
WITHIN = 0.05  # s in which a step has to be found
EVERY = 1.0  # s between steps that are put in
MOVING = 0.05  # rad/s of some joint, above which the arm moves
GAINS = (20.0, 40.0, 60.0, 100.0)  # 1/s, of the observer
GAIN = 60.0  # of the table of joints

LEARNT, TRIED = (7, 30), 120  # min, of simulated arms that nothing touches
STATED = (1.0, 10.0)  # false alarms an hour

PANDA = (
    ci.DHRow(0, 0, d=0.333),
    ci.DHRow(-np.pi / 2, 0),
    ci.DHRow(np.pi / 2, 0, d=0.316),
    ci.DHRow(np.pi / 2, 0.0825),
    ci.DHRow(-np.pi / 2, -0.0825, d=0.384),
    ci.DHRow(np.pi / 2, 0),
    ci.DHRow(np.pi / 2, 0.088),
)
FORCES = (5.0, 10.0, 20.0, 40.0)  # N
TOUCHED = (3, 5)  # forearm and hand, on which forces act
TRIALS = 200
RADIUS = 0.05  # m from the link's line


class Touched:
    """A log of touches: torque, the vendor's torque from outside, labels."""

    def __init__(self, file: Path) -> None:
        table = parquet.read_table(file)
        time = table["time"].to_numpy().astype(float)
        kept = np.concatenate([[True], np.diff(time) > 0])  # equal stamps
        self.name, self.time = file.stem, time[kept]
        self.label = table["label"].to_numpy()[kept] > 0
        names = ("q", "dq", "tau_J", "tau_ext")
        every = {
            name: np.column_stack([table[f"{name}{j}"].to_numpy() for j in range(7)])
            for name in names
        }
        q, dq, torque, vendor = (every[name][kept] for name in names)
        joints = tuple(f"joint_{j + 1}" for j in range(7))
        self.log = Recording(joints, self.time, q, velocity=dq, torque=torque)
        self.vendor = vendor
        step = np.diff(self.label.astype(int), prepend=int(self.label[0]))
        self.starts, ends = np.flatnonzero(step > 0), np.flatnonzero(step < 0)
        self.ends = np.append(ends, len(self.time))
        last = np.concatenate([[-np.inf], self.time[ends]])
        self.since = self.time - last[np.searchsorted(last, self.time, "right") - 1]
        soon = np.append(self.time[self.starts], np.inf)
        ahead = soon[np.searchsorted(soon, self.time, "right")] - self.time
        self.free = ~self.label & (self.since > SETTLED) & (ahead > EARLY)
        self.rest = ~self.label & (self.since >= REST)

    def touches(self) -> Iterator[slice]:
        """Yield the touches with rest before."""
        for start in self.starts:
            if self.since[start - 1] >= REST:
                yield slice(start, self.ends[self.ends > start][0])

    def delays(self, flags: np.ndarray) -> list[float]:
        """Return after what time each touch is flagged; infinite if it is not."""
        found = [t.start + np.flatnonzero(flags[t]) for t in self.touches()]
        return [
            float(self.time[hits[0]] - self.time[touch.start]) if len(hits) else np.inf
            for hits, touch in zip(found, self.touches(), strict=True)
        ]


def touches() -> list[str]:
    """Return the table of touches."""
    files = sorted((DATA / "franka_contacts").glob("*.parquet"))
    logs = [Touched(file) for file in files]
    names = ("short memory", "vendor", "vendor, larger")
    delays: dict[str, list[float]] = {name: [] for name in names}
    false: dict[str, list[int]] = {name: [] for name in names}
    over = []
    for log in logs:
        others = [other for other in logs if other is not log]
        detector = ContactDetector.fit(
            [other.log for other in others], free=[other.free for other in others]
        )
        level = np.max([abs(o.vendor[o.free]).max(axis=0) for o in others], axis=0)
        over.append((abs(log.vendor) / level).max(axis=1))
        flags = detector.along(log.log).contact
        for name, found in ((names[0], flags), (names[1], over[-1] > 1.0)):
            delays[name] += log.delays(found)
            false[name].append(int(found[log.rest].sum()))
    rest = sum(int(log.rest.sum()) for log in logs)
    resting = [o[log.rest] for o, log in zip(over, logs, strict=True)]
    factor = float(np.quantile(np.concatenate(resting), 1.0 - ALLOWED))
    for log, ratio in zip(logs, over, strict=True):
        delays[names[2]] += log.delays(ratio > factor)
        false[names[2]].append(int((ratio > factor)[log.rest].sum()))
    kinds = (
        "short memory, thresholds from the other files",
        "vendor's `tau_ext`, largest value at rest in the other files",
        f"the same, {factor:.1f} times: {ALLOWED:.1%} of the resting samples here",
    )
    lines = [
        f"{len(logs)} files; {len(delays[names[0]])} touches and {rest} resting "
        f"samples with {REST:g} s of rest before.",
        "",
        "| threshold on | touches found | delay, median | slowest | false samples |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, kind in zip(names, kinds, strict=True):
        after = np.array(delays[name])
        lines.append(
            f"| {kind} | {np.isfinite(after).sum()} of {len(after)} | "
            f"{np.median(after) * 1e3:.0f} ms | {after.max() * 1e3:.0f} ms | "
            f"{sum(false[name]) / rest:.2%} |"
        )
    return lines


def steps() -> list[str]:
    """Return the tables of the UR10e."""
    problem = ci.load_problem("problems/ur10e")
    logs = [problem.read(f"{name}.parquet") for name in UR10E]
    parts = [ci.build_regression(problem.model, problem.prepare(log)) for log in logs]
    controls = []
    for k in range(len(logs)):
        others = [part for j, part in enumerate(parts) if j != k]
        regression = others[0].joined(others[1:])
        regression = regression.weighted(joint_noise(problem.model, regression))
        estimate = ci.constrained_least_squares(
            problem.model, regression, constraints=problem.constraints
        )
        controls.append(
            control_model(estimate, friction_velocity=0.01, allow_refused=True)
        )
    tried = {gain: _steps_with(gain, logs, controls) for gain in GAINS}
    best = tried[GAIN]
    minutes = sum(log.duration for log in logs) / 60.0
    lines = [
        f"{len(logs)} logs, {minutes:.1f} min, of which {len(best.thresholds)} samples "
        f"move; {len(best.found)} steps on each joint; gain {GAIN:g}. False alarms: "
        f"{len(best.alarms)}{' (' if best.alarms else ''}{'; '.join(best.alarms)}"
        f"{')' if best.alarms else ''}. The largest distance without a contact is "
        f"{best.distance:.2f} of the limit.",
        "",
        "| joint | threshold, median (10 to 90 %) [N m] | largest torque from outside "
        "without a contact [N m] | noise of the measured torque [N m] | steps "
        f"of twice the threshold found within {WITHIN * 1e3:.0f} ms |",
        "|---|---:|---:|---:|---:|",
    ]
    middle = np.median(best.thresholds, axis=0)
    low, high = np.quantile(best.thresholds, [0.1, 0.9], axis=0)
    shares = best.found.mean(axis=0)
    for j, name in enumerate(logs[0].joints):
        lines.append(
            f"| {name} | {middle[j]:.2f} ({low[j]:.2f} to {high[j]:.2f}) | "
            f"{best.largest[j]:.1f} | {best.noise[j]:.2g} | {shares[j]:.1%} |"
        )
    lines += [
        "",
        "| gain of the observer | false alarms | medians of the thresholds [N m] | "
        "steps found, all joints |",
        "|---:|---:|---:|---:|",
    ]
    for gain, one in tried.items():
        medians = ", ".join(f"{x:.2g}" for x in np.median(one.thresholds, axis=0))
        lines.append(
            f"| {gain:g} | {len(one.alarms)} | {medians} | {one.found.mean():.1%} |"
        )
    return lines


@dataclass(frozen=True)
class Steps:
    """What the detector says of logs that were left out, and of steps in them."""

    alarms: list[str]
    distance: float  # largest without a contact, over the limit
    thresholds: np.ndarray  # of samples that move, shape (samples, joints)
    largest: np.ndarray  # torque from outside without a contact, shape (joints,)
    found: np.ndarray  # shape (steps, joints)
    noise: np.ndarray  # white noise of the torque while the arm moves, shape (joints,)


def _steps_with(
    gain: float, logs: Sequence[Recording], controls: Sequence[ControlModel]
) -> Steps:
    alarms, distances, thresholds, found, largest, noises = [], [], [], [], [], []
    for k, log in enumerate(logs):
        observer = MomentumObserver(controls[k], gain=gain)
        outside = [observer.along(other) for other in logs]
        detector = ContactDetector.fit([o for j, o in enumerate(outside) if j != k])
        contacts = detector.along(outside[k])
        alarms += [
            f"{Path(UR10E[k]).name} at {log.time[at] - log.time[0]:.1f} of "
            f"{log.duration:.1f} s, speed {abs(log.velocity[at]).max():.2f} rad/s"
            for at in contacts.starts
        ]
        distances.append(contacts.distance.max())
        moving = (abs(log.velocity) > MOVING).any(axis=1)
        moving &= np.isfinite(contacts.threshold[:, 0])
        thresholds.append(contacts.threshold[moving])
        largest.append(abs(outside[k].torque).max(axis=0))
        noises.append(_white(log.torque)[moving[3:]])
        found.append(
            _steps_found(observer, detector, outside[k], contacts.threshold, moving)
        )
    return Steps(
        alarms,
        max(distances),
        np.concatenate(thresholds),
        np.max(largest, axis=0),
        np.concatenate(found),
        np.sqrt(np.mean(np.concatenate(noises) ** 2, axis=0)),
    )


def _white(torque: np.ndarray) -> np.ndarray:
    """Return third differences, of which white noise has its own variance."""
    return np.asarray(np.diff(torque, 3, axis=0) / np.sqrt(20.0))


def _steps_found(
    observer: MomentumObserver,
    detector: ContactDetector,
    outside: Recording,
    threshold: np.ndarray,
    moving: np.ndarray,
) -> np.ndarray:
    """Return which steps of twice the threshold are found, shape (steps, joints)."""
    time, out = outside.time, []
    for at in np.arange(time[0] + 1.0, time[-1] - 1.0, EVERY):
        k = int(np.searchsorted(time, at))
        if not moving[k]:
            continue
        first = int(np.searchsorted(time, at - 0.45))
        last = int(np.searchsorted(time, time[k] + WITHIN, "right"))
        window = slice(first, last)
        # The observer is linear: it answers a step like a filter of first order.
        shape = np.where(
            time[window] > time[k],
            -np.expm1(-np.max(observer.gain) * (time[window] - time[k])),
            0.0,
        )
        of_joints = []
        for j in range(len(outside.joints)):
            torque = outside.torque[window].copy()
            sign = 1.0 if (len(out) + j) % 2 else -1.0
            torque[:, j] += sign * 2.0 * threshold[k, j] * shape
            log = Recording(
                outside.joints,
                time[window],
                outside.position[window],
                velocity=outside.velocity[window],
                acceleration=outside.acceleration[window],
                torque=torque,
                torque_command=outside.torque_command[window],
            )
            of_joints.append(bool(detector.along(log).contact[k - first :].any()))
        out.append(of_joints)
    return np.array(out)


def place() -> list[str]:
    """Return the table of places and forces."""
    files = sorted((DATA / "franka_contacts").glob("*.parquet"))
    logs = [Touched(file) for file in files]
    noise = ContactDetector.fit(
        [log.log for log in logs], free=[log.free for log in logs]
    ).covariance
    robot = ci.from_modified_dh("panda", list(PANDA))
    lines = [
        f"| force | {RADIUS * 1e3:.0f} mm off the line | link right | link possible | "
        "error of the force, median | 95 % intervals of its size that hold | their "
        "width, median | point off, median |",
        "|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for radius in (0.0, RADIUS):
        for size in FORCES:
            rng = np.random.default_rng(int(size))
            lines.append(_places(robot, noise, size, radius, rng))
    return lines


def _places(
    robot: ci.RobotModel,
    noise: np.ndarray,
    size: float,
    radius: float,
    rng: np.random.Generator,
) -> str:
    """Return the line of one size of force."""
    from consistent_id.service.contact_place import contact_place

    right, possible, errors, held, width, apart = 0, 0, [], 0, [], []
    for _ in range(TRIALS):
        q = rng.uniform(-1.5, 1.5, 7)
        link = int(rng.choice(TOUCHED))
        end = robot.joints[link + 1].translation
        aside = np.cross(rng.normal(size=3), end)
        local = rng.uniform(0.1, 0.9) * end + radius * aside / np.linalg.norm(aside)
        force = rng.normal(size=3)
        force *= size / np.linalg.norm(force)
        torque = _jacobian(robot, q, link, local).T @ force
        seen = torque + rng.multivariate_normal(np.zeros(7), noise)
        found = contact_place(robot, q, seen, noise)
        right += found.link == robot.link_names[link]
        possible += robot.link_names[link] in found.possible
        errors.append(float(np.linalg.norm(found.force - force)) / size)
        held += found.strengths[0] < size < found.strengths[1]
        width.append((found.strengths[1] - found.strengths[0]) / size)
        apart.append(np.linalg.norm(found.point - _point(robot, q, link, local)))
    return (
        f"| {size:g} N | {'yes' if radius else 'no'} | {right / TRIALS:.0%} | "
        f"{possible / TRIALS:.0%} | {np.median(errors):.0%} | {held / TRIALS:.0%} | "
        f"{np.median(width):.0%} | {np.median(apart) * 1e3:.0f} mm |"
    )


def _point(
    robot: ci.RobotModel, q: np.ndarray, link: int, at: np.ndarray
) -> np.ndarray:
    places = link_places(robot, q[None])
    return places.translation[0, link] + places.rotation[0, link] @ at


def _jacobian(
    robot: ci.RobotModel, q: np.ndarray, link: int, at: np.ndarray
) -> np.ndarray:
    """Return a point's Jacobian by central differences."""
    step = 1e-6 * np.eye(7)
    return np.column_stack(
        [
            (_point(robot, q + d, link, at) - _point(robot, q - d, link, at)) / 2e-6
            for d in step
        ]
    )


def rate() -> list[str]:
    """Return the table of false alarms of simulated arms that nothing touches."""
    lines = [
        "| arm | learnt from | tried on | stated, an hour | false alarms, an hour |",
        "|---|---:|---:|---:|---:|",
    ]
    for name in ("ur10_like", "seven_joints"):
        robot, rng = ARMS[name], np.random.default_rng(0)
        control = identified_arm(robot, rng)
        observer = MomentumObserver(control, gain=GAIN)

        def free(minutes: int, robot=robot, rng=rng, observer=observer) -> list:
            return [observer.along(free_minute(robot, rng)) for _ in range(minutes)]

        tried = free(TRIED)
        for minutes in LEARNT:
            logs = free(minutes)
            for stated in STATED:
                detector = ContactDetector.fit(logs, false_alarms=stated)
                alarms = sum(len(detector.along(log).starts) for log in tried)
                lines.append(
                    f"| `{name}` | {minutes} min | {TRIED / 60:g} h | {stated:g} | "
                    f"{60.0 * alarms / TRIED:.3g} |"
                )
    return lines


def identified_arm(robot: Robot, rng: np.random.Generator) -> ControlModel:
    """Return an arm as it is identified from a minute of motion."""
    model = ci.TorqueModel(
        loaded(urdf(as_drawn(robot, rng))),
        ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True),
    )
    log = ci.recordings.signals.differentiated(
        ci.recordings.signals.low_passed(
            free_minute(robot, rng), motion_cutoff=8.0, torque_cutoff=8.0
        )
    )
    regression = ci.build_regression(model, log)
    regression = regression.weighted(joint_noise(model, regression))
    estimate = ci.constrained_least_squares(model, regression)
    return control_model(estimate, friction_velocity=0.01, allow_refused=True)


def free_minute(robot: Robot, rng: np.random.Generator) -> Recording:
    """Return a minute of an arm whose friction falls with speed near rest."""
    moved = states(robot, rng, 60.0, "random motion")
    run = run_of(robot, None, moved, rotor=0.005)
    effort = np.array([part.effort for part in robot.parts])
    dry = np.tanh(run.velocity / 0.01) * np.exp(-((run.velocity / 0.1) ** 2))
    torque = run.torque + 0.01 * effort * dry
    torque += 0.005 * effort * rng.normal(size=torque.shape)
    return Recording(
        robot.joints,
        run.time,
        run.position,
        velocity=run.velocity + 0.002 * rng.normal(size=torque.shape),
        torque=torque,
    )


TABLES = {"touches": touches, "steps": steps, "place": place, "rate": rate}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or write them into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--write", type=Path)
    options = parser.parse_args(arguments)
    for name in options.only:
        with written_to(options.write, name, ["ur10e"] if name == "steps" else []):
            print("\n".join(TABLES[name]()))


if __name__ == "__main__":
    main()
