"""Other tools on the robots of `table.py`: the same logs, rows and judges.

    python benchmarks/table_rivals.py [--figaroh PYTHON] [--robots FILE.toml]
        [--only ROBOT ...] [--resume FILE.jsonl] [--write PAGE]

- FIGAROH 1.0.2, in the Python of `peers/`: its regressor with friction, rotor inertia
  and offset, on the motion that the problem file prepares, filtered like the torque;
  its base parameters, its consistent links by projection, and its direct fit under LMIs
  (`physical_fit`), whose settings hindsight chooses in the last of its rows.  Least
  squares here on the same columns must have the error of its base parameters.
- ``mujoco.sysid``, if MuJoCo has the extra ``sysid``: see `rollout_rivals.py`.
- Friction models M1 to M6 of BAM, written here: see `servos.py`.

Robots are those of a list like `robots.toml`.  What is missing is left out, and said.
With `--resume`, rows are kept in a file as soon as they are measured, and a robot's
rows of a tool are taken from there unless the robot's files have changed; each row says
when it was measured.  Intervals are those of `table.py`, of the same blocks; beside
each error is that of the recommended estimate of the problem file.
Seconds are of the processor: of FIGAROH those from the filtered rows to the estimate,
of others those of the fit.
"""

import argparse
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import servos
from kept_rows import Job, Kept, add_resume, inputs_of
from pages import written_to
from table import (
    ROBOTS,
    Interval,
    draft_of_entry,
    files,
    in_blocks,
    jackknife,
    relative_error,
    torque_squares,
    used_problems,
)

import consistent_id as ci
from consistent_id.estimation.method import Method
from consistent_id.problems.study import Study
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.robot.scaling import reference_bodies
from consistent_id.rollout import identify_servos, read_servo_logs
from consistent_id.rollout.problem_rollout import rollout_of

HERE = Path(__file__).parent
HEADER = (
    *("robot", "judged by", "tool", "its error", "recommended here"),
    *("recommended less the tool", "", "CPU s", "measured"),
)
ALIKE = (
    *("robot", "judged by", "tool", "its error", "recommended here, its columns"),
    *("this package less the tool", "", "CPU s", "CPU s here"),
    *("drives of the tool below zero", "measured"),
)
SAME = 1e-4  # by which errors of least squares on the same columns may differ, relative
TRIALS = 2800  # simulations of each friction model


def row(
    name: str, judge: str, tool: str, both: np.ndarray, figure: Any, seconds: float
) -> list[str]:
    """Return a row: a tool's figure, ours, and their difference with its interval.

    Parameters
    ----------
    both : ndarray, shape (blocks, 2, ...)
        Sums of each block, of the tool and of the recommended estimate.
    seconds : float
        Processor time of the tool.
    """
    scale = 100.0 if judge.startswith("torque") else 1e3
    its, ours = (jackknife(both[:, k], figure) for k in (0, 1))
    less: Interval = jackknife(both, lambda sums: figure(sums[1]) - figure(sums[0]))
    cells = (its.text(scale), ours.text(scale), less.text(scale), less.word)
    return [name, judge, tool, *cells, f"{seconds:.2f}"]


def of_figaroh(
    name: str, problem: ci.Problem, python: str, alike: list[list[str]]
) -> Iterator[list[str]]:
    """Yield the rows of FIGAROH's stages on the problem of a named robot with torque.

    Rows of its direct fits against this package on the same columns go to `alike`.
    """
    study = Study(problem)
    model, best = problem.model, study.estimate(study.recommendation.method)
    training = [motion_of(model, log, None) for log in study.training]
    judged = [motion_of(model, log, None) for log in study.validation]
    with TemporaryDirectory() as made:
        predicted, about = stages(problem, training, judged, python, Path(made))
    ours = [torque_squares(best, log) for log in study.validation]

    def error(sums: np.ndarray) -> float:
        return relative_error(model, sums)

    def against(stage: str, ours: Sequence[np.ndarray], tool: str) -> list[str]:
        both = np.stack([in_blocks(squares[stage]), in_blocks(ours)], axis=1)
        seconds = about[stage]["seconds"]
        return row(name, "torque [%]", tool, both, error, seconds)

    squares: dict[str, list[np.ndarray]] = {}
    tools = {}
    for stage, said in about.items():
        tool = f"FIGAROH, {stage}"
        if said["said"]:
            tool += f" ({said['said']})"
        tools[stage] = tool
        if stage not in predicted:
            blank = ("-", "-", "-", f"{said['seconds']:.2f}")
            yield [name, "torque [%]", tool, "rejected", *blank]
            continue
        squares[stage] = []
        for motion, tau in zip(judged, predicted[stage], strict=True):
            weights = 1.0 if motion.weights is None else motion.weights
            missed = weights * (motion.torque - tau)
            parts = [missed**2, (weights * motion.torque) ** 2]
            squares[stage].append(np.hstack(parts))
        yield against(stage, ours, tool)
    began = process_time()
    same = Study(replace(problem, model=with_its_columns(model)))
    least = same.estimate(Method.LEAST_SQUARES)
    fit = same.estimate(same.recommendation.method)
    seconds = process_time() - began
    check = [
        error(sum(one.sum(axis=0) for one in parts))
        for parts in (
            squares["base parameters"],
            [torque_squares(least, log) for log in same.validation],
        )
    ]
    if not np.isclose(*check, rtol=SAME, atol=0.0):
        raise SystemExit(f"{name}: errors of least squares there and here, {check}")
    mine = [torque_squares(fit, log) for log in same.validation]
    for stage in squares:
        if stage.startswith("physical_fit"):
            cells = against(stage, mine, tools[stage])
            alike.append([*cells, f"{seconds:.2f}", about[stage]["below zero"]])


def with_its_columns(model: ci.TorqueModel) -> ci.TorqueModel:
    """Return a model with the drives of FIGAROH's columns, and the same couplings."""
    drive = ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
    couplings = tuple(
        replace(c, coulomb="sign", velocity_scale=None) for c in model.couplings
    )
    return replace(model, drive=drive, couplings=couplings)


def nominal_bodies(robot: Any) -> np.ndarray:
    """Return the bodies that priors are of here, with the masses that are stated."""
    bodies = np.array(reference_bodies(robot))
    stated = [link.datasheet.mass for link in robot.links]
    masses = [m or body[0] for m, body in zip(stated, bodies, strict=True)]
    return bodies * (np.array(masses) / bodies[:, 0])[:, None]


def stages(
    problem: ci.Problem,
    training: Sequence[Motion],
    judged: Sequence[Motion],
    python: str,
    folder: Path,
) -> tuple[dict[str, list[np.ndarray]], dict[str, dict[str, Any]]]:
    """Return the torque of judged motions, (samples, joints), by FIGAROH's stages.

    With the seconds of each stage, and what its solvers said; what was rejected has no
    torque.
    """
    robot = problem.model.robot
    (folder / "robot.urdf").write_bytes(problem.model_files["urdf"].read_bytes())
    np.save(folder / "joints.npy", np.array(robot.joint_names))
    np.save(folder / "gravity.npy", robot.gravity)
    motions = [*training, *judged]
    for k, motion in enumerate(motions):
        along = motion if motion.filtered is None else motion.filtered.along
        file = folder / f"motion{k:02}.npz"
        np.savez(file, q=along.q, dq=along.dq, ddq=along.ddq)
    command = [python, str(HERE / "peers" / "real.py")]
    subprocess.run([*command, "columns", str(folder)], check=True)
    files = sorted(folder.glob("motion*.npy"))
    names, count = problem.model.torque_joints, len(training)
    joints = [robot.joint_names.index(name) for name in names]
    rows = [
        through(motion, with_couplings(problem.model, np.load(file), motion)[joints])
        for motion, file in zip(motions, files, strict=True)
    ]
    W = np.concatenate(rows[:count], axis=1)
    tau = np.concatenate([m.torque for m in training]).T
    held = np.concatenate(rows[count:], axis=1)
    width = W.shape[-1]
    np.savez(
        folder / "rows.npz",
        W=W.reshape(-1, width),
        tau=tau.ravel(),
        held=held.reshape(-1, width),
        judged=np.concatenate([m.torque for m in judged]).T.ravel(),
        reference=nominal_bodies(robot),
        joints=len(joints),
    )
    subprocess.run([*command, "fit", str(folder)], check=True)
    ends = np.cumsum([len(m.torque) for m in judged])[:-1]
    about = json.loads((folder / "about.json").read_text())
    with np.load(folder / "predicted.npz") as found:
        predicted = {
            stage: np.split(found[stage].reshape(len(joints), -1).T, ends)
            for stage in found
        }
    return predicted, about


def with_couplings(model: ci.TorqueModel, W: np.ndarray, motion: Motion) -> np.ndarray:
    """Return columns with those of coupled gears, which users of FIGAROH add.

    The motor of the second joint turns with the first: its inertia, viscous and dry
    friction.
    """
    along = motion if motion.filtered is None else motion.filtered.along
    for coupling in model.couplings:
        names = model.robot.joint_names
        one, other = (names.index(n) for n in (coupling.first, coupling.second))
        extra = np.zeros((*W.shape[:2], 3))
        for joint, partner in ((one, other), (other, one)):
            extra[joint, :, 0] = along.ddq[:, partner]
            extra[joint, :, 1] = along.dq[:, partner]
            extra[joint, :, 2] = np.sign(along.dq[:, one] + along.dq[:, other])
        W = np.concatenate([W, extra], axis=2)
    return W


def through(motion: Motion, W: np.ndarray) -> np.ndarray:
    """Return columns as the motion's filter makes them, (joints, rows, columns)."""
    return np.stack([motion.through(own, row=j) for j, own in enumerate(W)])


def of_sysid(name: str, problem: ci.Problem) -> list[str]:
    """Return the row of ``mujoco.sysid`` on a named robot's problem of commands."""
    import rollout_rivals

    (log,) = problem.logs("training")
    began = process_time()
    with redirect_stdout(sys.stderr):  # its optimiser reports each step
        found, _ = rollout_rivals.fitted(problem, log)
    seconds = process_time() - began
    theirs = rollout_rivals.replay_errors(problem, found, problem.logs("validation"))
    done = rollout_of(Study(problem), refine=True, choose=True)
    ours = [r.errors for r in next(iter(done.rollout.replays.values()))]

    def sums(errors: Sequence[np.ndarray]) -> np.ndarray:
        squares = [(e**2).sum(axis=1, keepdims=True) for e in errors]
        counts = [np.full((len(e), 1), e.shape[1], dtype=float) for e in errors]
        return in_blocks([np.hstack(p) for p in zip(squares, counts, strict=True)])

    both = np.stack([sums(theirs), sums(ours)], axis=1)
    return row(
        name,
        "rollout [mrad]",
        "mujoco.sysid",
        both,
        lambda s: float(np.sqrt(s[0] / s[1])),
        seconds,
    )


def of_servos(entry: Mapping[str, Any], folder: Path) -> Iterator[list[str]]:
    """Yield the rows of BAM's friction models on a hobby servo."""
    robot = ci.load_robot(*files([entry["robot"]], folder))
    training, judged = (
        read_servo_logs(files(entry[key], folder), robot.joint_names)
        for key in ("logs", "validate")
    )
    (own,) = identify_servos(robot, training, judged).joints
    ours = np.array(list(own.validation[own.chosen.name].values()))
    pieces = [servos._whole(robot, part) for part in (training, judged)]
    for model in servos.MODELS:
        began = process_time()
        generations = TRIALS // servos.POPULATION
        _, theirs = servos.rival(model, *pieces, generations, seed=0)
        seconds = process_time() - began
        ones = np.ones(len(theirs))
        both = np.stack([np.column_stack([e, ones]) for e in (theirs, ours)], axis=1)
        tool = f"BAM's {model}, own code"
        figures = (both, lambda s: s[0] / s[1], seconds)
        yield row(entry["name"], "position [mrad]", tool, *figures)


def jobs(
    entries: Sequence[Mapping[str, Any]], folder: Path, figaroh: str | None
) -> Iterator[Job]:
    """Yield what each tool does with each robot of a list."""
    for entry in entries:
        name, inputs = entry["name"], inputs_of(entry, folder)
        if entry.get("servo"):
            yield Job(name, "BAM", inputs, lambda _, e=entry: of_servos(e, folder))
            continue
        try:
            problem = problem_of_entry(entry, folder)
        except ci.ConsistentIdError as cause:
            left_out(name, str(cause))
            continue
        if problem.table.data is None:
            left_out(name, "its logs are simulated")
        elif problem.gains is not None:
            if has_sysid():
                row_of = partial(of_sysid, name, problem)
                yield Job(name, "sysid", inputs, lambda _, of=row_of: [of()])
            else:
                left_out(name, "MuJoCo has no extra `sysid`")
        elif figaroh is None:
            left_out(name, "no --figaroh")
        elif problem.model_files.get("urdf") is None:
            left_out(name, "FIGAROH reads URDF")
        else:
            of = partial(of_figaroh, name, problem, figaroh)
            yield Job(name, "FIGAROH", inputs, of)


def left_out(name: str, why: str) -> None:
    """Say which robot has no rows of a tool."""
    print(f"{name}: left out: {why}", file=sys.stderr, flush=True)


def has_sysid() -> bool:
    """Whether MuJoCo's extra is installed; without it, the module is empty."""
    from mujoco import sysid

    return hasattr(sysid, "optimize")


def problem_of_entry(entry: Mapping[str, Any], folder: Path) -> ci.Problem:
    """Return the problem of an entry of a list, drafted where it has no file."""
    if "problem" in entry:
        return ci.load_problem(folder / entry["problem"], trust=True)
    return draft_of_entry(entry, folder).problem()


def show(header: Sequence[str]) -> None:
    """Print the head of a table."""
    print(f"| {' | '.join(header)} |")
    print("|---" * len(header) + "|", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--figaroh", help="Python that has FIGAROH, see peers/")
    parser.add_argument("--robots", type=Path, default=ROBOTS, help="a list of yours")
    parser.add_argument("--only", nargs="*", metavar="ROBOT", help="some of the list")
    add_resume(parser)
    parser.add_argument("--write", type=Path, help="page with marks of the table")
    options = parser.parse_args()
    entries = tomllib.loads(options.robots.read_text())["robot"]
    if options.only:
        entries = [entry for entry in entries if entry["name"] in options.only]
    used = used_problems(entries) if options.robots == ROBOTS else []
    kept = Kept(options.resume)
    with written_to(options.write, "rivals", used):
        every_alike: list[list[str]] = []
        show(HEADER)
        for job in jobs(entries, options.robots.parent, options.figaroh):
            rows, alike = kept.done(job)
            every_alike += alike
            for cells in rows:
                print(f"| {' | '.join(cells)} |", flush=True)
        if every_alike:
            print("\nFIGAROH's direct fit, and this package on FIGAROH's columns:\n")
            show(ALIKE)
        for cells in every_alike:
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
