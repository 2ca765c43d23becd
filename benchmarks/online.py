"""An estimate that follows: its cost, loads on and off, friction of a warm servo.

``python benchmarks/online.py [--only speed loads alarms warmth]
[--write docs/following.md]``

Speed: an arm of seven joints, CPU time of one core.  Loads: logs of a UR10e without a
load, followed by logs with one that begin at any time of its motion; model, watch and
limit come from the other logs without a load.  Alarms: a simulated arm without a
change of load, with friction that the model lacks.  Warmth: a simulated
arm whose friction falls as it warms up, the UR10e's logs, and a servo's logs at 27 to
40 degrees.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as parquet
from contacts import MOVING, PANDA, UR10E, free_minute, identified_arm
from pages import written_to
from payload import ARMS

import consistent_id as ci
from consistent_id.recordings import Recording
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.service import (
    ControlModel,
    OnlineEstimate,
    OnlineState,
    control_model,
)
from consistent_id.service.online_estimate import resolved
from consistent_id.service.residual_spread import SLOW
from consistent_id.service.running_log import blocks_of, local_motion

DATA = Path(os.environ["CONSISTENT_ID_DATASETS"])
PREPARED = {"torque_delay": 0.0074}  # s; as the problem file states
LOADED = {  # log: the log without a load before it, broken rows
    "payload/ur-20_02_19_14harm50secLoad": ("ur-20_02_19_14harm50sec", ()),
    "payload/ur-20_02_19_15harm50secLoad": ("ur-20_02_19_15harm50sec", (1, 2)),
    "payload/ur-20_01_31-load": ("ur-20_02_05-20sec_8harm", ()),
    "payload/ur-20_01_13-load_2600": ("ur-20_02_06-20sec_10harm", ()),
}
TURNS = ((0, 1), (2, 3), (4, 5), (6, 9), (7, 8))
"""Logs that are left out together; the last two are of one day."""

EVERY = 2.0  # s between the times at which a load comes
WITHIN = 0.5  # s in which it has to be announced
OFTEN = 60.0  # 1/h; a rate of false alarms that seven minutes can show
LEARNT, TRIED, RATE = 7, 20, 30.0  # min of free motion, min that are tried, 1/h
BANDS = (0.0, 0.5, 1.0, 2.0, np.inf)  # of a load's torque, over the limit
MEMORY = 15.0  # s, of the tables of friction
FALL, WARMING, PIECE = 0.4, 60.0, 2.0  # of friction; s; s of constant friction
LENGTH = 2.0  # s of each trial
PAUSE = 1.0  # s of the clock between two logs


def seven_joints() -> tuple[ci.TorqueModel, np.ndarray]:
    """Return an arm and its true parameters."""
    robot = ci.from_modified_dh("arm", list(PANDA))
    drive = ci.DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.02,
        offset=True,
        rotor_inertia=True,
    )
    model = ci.TorqueModel(robot, drive)
    rng = np.random.default_rng(0)
    bodies = []
    for _ in range(7):
        mass, centre = rng.uniform(1, 4), rng.normal(size=3) * 0.06
        size = rng.normal(size=(3, 3)) * 0.05
        moment = mass * (size @ size.T + 0.002 * np.eye(3) + np.outer(centre, centre))
        inertia = np.trace(moment) * np.eye(3) - moment
        upper = inertia[np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])]
        bodies += [mass, *(mass * centre), *upper]
    of_drive = {"viscous": 2.0, "coulomb": 1.0, "offset": 0.3, "rotor_inertia": 0.1}
    return model, np.array([*bodies, *(of_drive[t] for _, t in model.layout.drive)])


def simulated(
    model: ci.TorqueModel, truth: np.ndarray, seed: int, seconds: float = 20.0
) -> Recording:
    """Return a log of a random motion at 200 Hz."""
    joints, rng = model.robot.joint_names, np.random.default_rng(seed)
    path = ci.recordings.FourierTrajectory(
        joints,
        ci.recordings.harmonics_of(0.1, 5),
        [0] * len(joints),
        *rng.normal(size=(2, 5, len(joints))) * 0.2,
        duration=seconds,
    )
    return ci.simulate_torque(
        model, truth, path.recording(rate=200.0), noise=0.3, rng=rng
    )


def estimated(model: ci.TorqueModel, truth: np.ndarray, log: Recording) -> ci.Estimate:
    """Return the constrained estimate with true masses."""
    masses = dict(zip(model.robot.link_names, truth[:70:10].tolist(), strict=True))
    known = [ci.PhysicalConsistency(), ci.FixedMasses(masses), ci.NonNegativeDrive()]
    regression = ci.build_regression(model, log)
    regression = regression.weighted(joint_noise(model, regression))
    return ci.constrained_least_squares(model, regression, constraints=known)


def speed() -> list[str]:
    """Return the table of CPU times."""
    model, truth = seven_joints()
    started = process_time()
    estimate = estimated(model, truth, simulated(model, truth, 1))
    whole = process_time() - started
    online = OnlineEstimate(estimate, period=np.inf)
    watched = replace(online, period=0.5).watching(
        [simulated(model, truth, seed) for seed in range(2, 6)]
    )
    times: dict[str, list[float]] = {"warm": [], "cold": [], "follow": []}
    steps: list[int] = []
    certified = 0
    state = online.start()
    state = online.follow(state, simulated(model, truth, 6))
    state = replace(state, time=-1.0)
    for block in blocks_of(simulated(model, truth, 7), 0.5):
        state = online.follow(state, block)
        found = None
        for kind, path in (("warm", state.path), ("cold", ())):
            begun = process_time()
            now = resolved(online, replace(state, path=path), online.alone)
            times[kind].append(process_time() - begun)
            found = found or now
        steps.append(found.fit.steps)
        certified += found.fit.optimality.verdict == "certified"
        state = replace(state, path=found.fit.path)
    following = watched.start()
    for block in blocks_of(simulated(model, truth, 7), 0.1):
        begun = process_time()
        following = watched.follow(following, block)
        times["follow"].append(process_time() - begun)
    lines = [
        f"7 joints, {len(truth)} parameters, 7 links physically consistent; "
        f"{certified} of {len(steps)} solutions certified, {np.mean(steps):.1f} steps "
        "of Newton's method in the mean.",
        "",
        "| | CPU time, median | 95 % |",
        "|---|---:|---:|",
    ]
    kinds = {
        "warm": "solution with its certificate, warm, after 0.5 s of new samples",
        "cold": "the same without a start",
        "follow": "block of 20 samples, watch for loads, solution every 0.5 s",
    }
    for kind, words in kinds.items():
        middle, most = np.quantile(np.array(times[kind][2:]) * 1e3, [0.5, 0.95])
        lines.append(f"| {words} | {middle:.1f} ms | {most:.1f} ms |")
    lines.append(f"| `constrained_least_squares`, once | {whole * 1e3:.0f} ms | |")
    return lines


def estimate_of(problem: ci.Problem, parts: Sequence[ci.Regression]) -> ci.Estimate:
    """Return the constrained estimate of several logs."""
    regression = parts[0].joined(parts[1:])
    regression = regression.weighted(joint_noise(problem.model, regression))
    return ci.constrained_least_squares(
        problem.model, regression, constraints=problem.constraints
    )


def later(log: Recording, end: float) -> Recording:
    """Return a log that begins after another one's end."""
    return replace(log, time=log.time - log.time[0] + end + PAUSE)


class Trial(NamedTuple):
    """After what time a change is announced, and how far its torque can be seen.

    Attributes
    ----------
    delay : float, [s]
        Infinite if it is not announced.
    distance : float
        Of the load's static torque in the first half second, in standard deviations of
        the residual; dry friction of joints at rest counts as residual.
    """

    delay: float
    distance: float


def trials(
    online: OnlineEstimate,
    state: OnlineState,
    log: Recording,
    loaded: bool,
    carried: ControlModel,
) -> list[Trial]:
    """Return the trials of a change at any time of a log's motion.

    Parameters
    ----------
    carried : ControlModel
        Of the robot with the load.
    """
    free = control_model(online.estimate, allow_refused=True)
    moving = log.time[(abs(log.velocity) > MOVING).any(axis=1)]
    delays = []
    for begin in np.arange(moving[0], moving[-1] - LENGTH, EVERY):
        first, last = np.searchsorted(log.time, (begin, begin + LENGTH))
        part = later(log.samples(slice(int(first), int(last))), state.time)
        now, delay = state, np.inf
        for block in blocks_of(part, 0.1):
            now = online.follow(now, block)
            if now.loaded == loaded:
                delay = now.time - part.time[0]
                # Samples wait for their successors.
                delay += online.half * float(np.median(np.diff(part.time)))
                break
        soon = part.samples(slice(0, int((part.time < part.time[0] + WITHIN).sum())))
        load = carried.gravity(soon.position) - free.gravity(soon.position)
        near = 1.0 - np.tanh(soon.velocity / SLOW) ** 2
        watch = online.watch
        spread = (
            watch.covariance + np.eye(load.shape[1]) * ((near * watch.held**2)[:, None])
        )
        scaled = np.linalg.solve(spread, load[..., None])[..., 0]
        distance = np.sqrt(np.mean(np.sum(scaled * load, axis=1)))
        delays.append(Trial(delay, float(distance)))
    return delays


def loads() -> list[str]:
    """Return the table of the UR10e."""
    problem = ci.load_problem("problems/ur10e")
    logs = [problem.read(f"{name}.parquet") for name in UR10E]
    parts = [ci.build_regression(problem.model, problem.prepare(log)) for log in logs]
    heavy = {
        name: (problem.read(f"{name}.parquet", omit=omit), before)
        for name, (before, omit) in LOADED.items()
    }
    alarms, hours, lines, more = [], 0.0, [], 0
    every: dict[bool, list[tuple[Trial, float]]] = {True: [], False: []}
    for turn in TURNS:
        others = [j for j in range(len(logs)) if j not in turn]
        estimate = estimate_of(problem, [parts[j] for j in others])
        online = OnlineEstimate(estimate, **PREPARED).watching(
            [logs[j] for j in others], false_alarms=1.0
        )
        often = online.watching([logs[j] for j in others], false_alarms=OFTEN).watch
        for k in turn:
            log, name = logs[k], Path(UR10E[k]).name
            states = online.along(log)
            alarms += sorted(
                f"{name} at {t - log.time[0]:.1f} s"
                for t in {s.change.time for s in states if s.change}
            )
            hours += log.duration / 3600.0
            scores = np.array([s.score for s in states])
            top, limit = scores.max(), online.watch.limit
            above = scores * limit > often.limit
            more += int((np.diff(above.astype(int), prepend=0) > 0).sum())
            print(f"{name}: largest score {top:.2f} of {limit:.3g}", file=sys.stderr)
            for load, (loaded, before) in heavy.items():
                if name == before:
                    line, of_log = _of_load(online, states[-1], load, loaded, log)
                    lines.append(line)
                    for way, found in of_log.items():
                        every[way] += [(t, online.watch.limit) for t in found]
                    print(lines[-1], file=sys.stderr)
    return [
        f"{len(logs)} logs without a load, {hours * 60:.1f} min; false alarms, stated "
        f"rate one an hour: {len(alarms)}{' (' if alarms else ''}{'; '.join(alarms)}"
        f"{')' if alarms else ''}. Stated rate {OFTEN:g} an hour, which is "
        f"{OFTEN * hours:.1f} expected: {more}.",
        "",
        "| log with a load | on: announced within 0.5 s | median | 95 % | "
        "off: announced within 0.5 s | median | 95 % | mass at its end |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
        *lines,
        "",
        "| torque of the load, over the limit | changes, on | announced within 0.5 s | "
        "changes, off | announced within 0.5 s |",
        "|---|---:|---:|---:|---:|",
        *_by_distance(every),
    ]


def alarms() -> list[str]:
    """Return the table of false alarms of simulated arms."""
    lines = [
        "| arm | learnt from | tried on | stated, an hour | false alarms |",
        "|---|---:|---:|---:|---:|",
    ]
    for name in ("ur10_like", "seven_joints"):
        robot, rng = ARMS[name], np.random.default_rng(0)
        online = OnlineEstimate(identified_arm(robot, rng).estimate)
        free = [free_minute(robot, rng) for _ in range(LEARNT)]
        online = online.watching(free, false_alarms=RATE)
        said = 0
        for _ in range(TRIED):
            states = online.along(free_minute(robot, rng))
            said += len({s.change.time for s in states if s.change is not None})
        lines.append(f"| `{name}` | {LEARNT} min | {TRIED} min | {RATE:g} | {said} |")
    return lines


def _by_distance(every: dict[bool, list[tuple[Trial, float]]]) -> list[str]:
    """Return announcements by the distance of the load's torque over the limit."""
    lines = []
    for low, high in pairwise(BANDS):
        cells = [f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"]
        for found in every.values():
            inside = [t for t, limit in found if low <= t.distance / limit < high]
            cells += [f"{len(inside)}", f"{sum(t.delay <= WITHIN for t in inside)}"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _of_load(
    online: OnlineEstimate,
    state: OnlineState,
    name: str,
    loaded: Recording,
    free: Recording,
) -> tuple[str, dict[bool, list[Trial]]]:
    """Return the line of a log with a load, and its trials: on, off."""
    if state.loaded:  # a false alarm
        state = online.start(state.time)
    with_load = online.along(later(loaded, state.time), start=state)[-1]
    carried = control_model(online.delivered(with_load), allow_refused=True)
    mass, error = (values[0] for values in online.load(with_load))
    found = {
        True: trials(online, state, loaded, True, carried),
        False: trials(online, with_load, free, False, carried),
    }
    cells = [Path(name).name]
    for of_way in found.values():
        delays = np.array([trial.delay for trial in of_way])
        middle, most = np.quantile(delays, [0.5, 0.95], method="nearest")
        cells += [
            f"{(delays <= WITHIN).sum()} of {len(delays)}",
            f"{middle:.2f} s",
            f"{most:.2f} s" if np.isfinite(most) else f"over {LENGTH:g} s",
        ]
    line = f"| {' | '.join(cells)} | {mass:.2f} kg, standard error {error:.2f} |"
    return line, found


def warmth() -> list[str]:
    """Return the tables of friction that changes."""
    return [*_simulated_warmth(), "", *_recorded_drift(), "", *_servo()]


def _simulated_warmth() -> list[str]:
    """Return the table of an arm whose friction falls by 40 %."""
    model, cold = seven_joints()
    estimate = estimated(model, cold, simulated(model, cold, 1))
    online = OnlineEstimate(estimate, memory=MEMORY)
    frozen = replace(online, period=np.inf)
    friction = np.array([t in ("viscous", "coulomb") for _, t in model.layout.drive])
    columns = model.layout.inertial_size + np.flatnonzero(friction)
    state, still = online.start(), frozen.start()
    lines = [
        f"A simulated arm of seven joints; its friction falls by {FALL:.0%} with a "
        f"time constant of {WARMING:g} s; memory {MEMORY:g} s. Errors of friction are "
        "the median over the 14 coefficients, those of the torque of the last "
        f"{MEMORY:g} s, all joints.",
        "",
        "| time | friction, of the cold | error of friction, followed | not followed | "
        "error of the torque, followed | not followed |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for k in range(round(3.0 * WARMING / PIECE)):
        now = cold.copy()
        left = 1.0 - FALL * -np.expm1(-k * PIECE / WARMING)
        now[columns] *= left
        piece = simulated(model, now, 100 + k, PIECE).samples(slice(None, -1, 2))
        piece = replace(piece, time=piece.time + k * PIECE)
        state = online.along(piece, start=state)[-1]
        still = frozen.along(piece, start=still)[-1]
        if (k + 1) % round(WARMING / 2 / PIECE) == 0:
            cells = [f"{(k + 1) * PIECE:g} s", f"{left:.0%}"]
            for one in (state, still):
                off = abs(one.parameters[columns] / now[columns] - 1.0)
                cells.append(f"{np.median(off):.1%}")
            for one in (state, still):
                sums = one.errors.sum(axis=0)
                cells.append(f"{np.sqrt(sums[0] / sums[1]):.1%}")
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def _recorded_drift() -> list[str]:
    """Return the table of the UR10e, followed from the estimate of other logs."""
    problem = ci.load_problem("problems/ur10e")
    logs = [problem.read(f"{name}.parquet") for name in UR10E]
    parts = [ci.build_regression(problem.model, problem.prepare(log)) for log in logs]
    lines = [
        "The UR10e: error of the torque predicted for the next 0.1 s, all joints, over "
        "the second half of each log; the estimate is of logs of other turns.",
        "",
        "| log | not followed | followed | friction of all joints at its end, of the "
        "start's |",
        "|---|---:|---:|---:|",
    ]
    for turn in TURNS:
        others = [part for j, part in enumerate(parts) if j not in turn]
        online = OnlineEstimate(estimate_of(problem, others), memory=MEMORY, **PREPARED)
        for k in turn:
            cells = [Path(UR10E[k]).name]
            middle = logs[k].time[len(logs[k]) // 2]
            for one in (replace(online, period=np.inf), online):
                states = one.along(logs[k])
                cells.append(f"{_error_after(states, middle, MEMORY):.1%}")
            ratio = _friction(online.estimate, states[-1].parameters)
            cells.append(f"{ratio:.0%}")
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def _error_after(states: Sequence[OnlineState], begin: float, memory: float) -> float:
    """Return the relative error of predictions after a time, from faded sums."""
    total = np.zeros(2)
    for before, now in pairwise(states):
        if now.time > begin:
            fade = np.exp(-(now.time - before.time) / memory)
            total += (now.errors - fade * before.errors).sum(axis=0)
    return float(np.sqrt(total[0] / total[1]))


def _friction(estimate: ci.Estimate, x: np.ndarray) -> float:
    """Return the Coulomb friction of all joints over that of the estimate."""
    names = estimate.model.layout.names
    columns = [k for k, name in enumerate(names) if name.endswith(".coulomb")]
    return float(x[columns].sum() / estimate.parameters[columns].sum())


def _servo() -> list[str]:
    """Return the table of a servo's logs, each fitted by itself."""
    lines = [
        "A servo with a known mass; least squares on each log by itself, in motion "
        "above 0.3 rad/s, with the scale of the duty free. Intervals are of two "
        "standard errors, with ten samples as one.",
        "",
        "| log | temperature | torque at full duty | viscous | Coulomb |",
        "|---|---:|---:|---:|---:|",
    ]
    for file in sorted((DATA / "servo_pendulum").glob("*.parquet")):
        table = parquet.read_table(file)
        names = ("time", "position", "load", "input_volts", "temp")
        values = {n: table[n].to_numpy().astype(float) for n in names}
        kept = np.concatenate([[True], np.diff(values["time"]) > 1e-4])
        time, q, duty, volts, warm = (values[n][kept] for n in names)
        torque = duty / 885.0 * np.median(volts) / 7.4
        log = Recording(("servo",), time, q[:, None], torque=torque[:, None])
        found = local_motion(log, 10)
        columns = (found.position, found.velocity, found.acceleration, found.torque)
        q, dq, ddq, tau = (c[:, 0] for c in columns)
        use = (abs(dq) > 0.3) & (abs(tau) < 0.97)
        if use.sum() < 300:
            continue
        known = 0.49 * 0.1 * (9.81 * np.sin(q) + 0.1 * ddq)
        A = np.column_stack([known, ddq, dq, np.sign(dq), np.ones_like(q)])[use]
        x = np.linalg.lstsq(A, tau[use], rcond=None)[0]
        rest = tau[use] - A @ x
        error = 2.0 * np.sqrt(10.0 * rest.var() * np.diag(np.linalg.pinv(A.T @ A)))
        stall = 1.0 / x[0]
        cells = [f"{warm.min():.0f} to {warm.max():.0f}", f"{stall:.2f} N m"]
        cells += [f"{x[k] * stall:.3f} ± {error[k] * stall:.3f}" for k in (2, 3)]
        lines.append(f"| {file.stem} | {' | '.join(cells)} |")
    return lines


TABLES = {"speed": speed, "loads": loads, "alarms": alarms, "warmth": warmth}
SIMULATED = ("speed", "alarms")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or write them into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--write", type=Path)
    options = parser.parse_args(arguments)
    for name in options.only:
        lines = TABLES[name]()
        with written_to(options.write, name, [] if name in SIMULATED else ["ur10e"]):
            print("\n".join(lines))


if __name__ == "__main__":
    main()
