"""Every robot with data here, on one page: what each path reaches, and how surely.

``python benchmarks/table.py [--robots FILE.toml] [--only NAME ...] [--resume FILE]
[--write PAGE]``

The list is `robots.toml`; ``--robots`` takes one of your own, of the same form.  A
robot with a problem file is worked through twice: as the file says (``file``), and
from the model and the logs alone (``default``: what ``identify MODEL LOGS`` does).
Estimates are judged by recordings that were not used to choose or fit anything.  The
range beside an error is a 95 % interval from a jackknife over blocks of these
recordings.  ``--write`` puts the table between the marks of a page; with ``--resume``,
rows are those of a file where they are there.  Seconds are those of the processor.
"""

import argparse
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from force_plates import least_error, person
from kept_rows import Job, Kept, add_resume, files, inputs_of
from pages import written_to
from scipy.stats import t as student
from selection_bare import bare_draft, unseen

import consistent_id as ci
from consistent_id.estimation.method import Method
from consistent_id.estimation.torque_error import stacked_of_kinds
from consistent_id.problems.draft import Draft
from consistent_id.problems.study import Study
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.rollout import identify_servos, read_servo_logs, rollout
from consistent_id.rollout.problem_rollout import rollout_of
from consistent_id.rollout.settings import gains_of

HERE = Path(__file__).parent
ROBOTS = HERE / "robots.toml"
BLOCKS = 10
SHOWN = {
    Method.LEAST_SQUARES: "least squares",
    Method.WEIGHTED_LEAST_SQUARES: "weighted",
    Method.CONSTRAINED: "constrained",
}
HEADER = (
    *("robot", "path", "judged by", *SHOWN.values(), "recommended"),
    *("recommended less least squares", "", "expected, 80 % range"),
    *("consistent links", "verdict", "CPU s", "measured"),
)
TORQUE, ROLLOUT, SERVO = "torque [%]", "rollout [mrad]", "position [mrad]"


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % interval.

    Parameters
    ----------
    value, half : float
        `half` is half the interval's width.
    """

    value: float
    half: float

    def text(self, scale: float) -> str:
        """Return it for people, in a unit of ``1 / scale``."""
        value, half = scale * self.value, scale * self.half
        return f"{value:.2f} ({value - half:.2f} to {value + half:.2f})"

    @property
    def word(self) -> str:
        """Whether a difference is a win, a loss, or neither."""
        if abs(self.value) <= self.half:
            return "alike"
        return "win" if self.value < 0.0 else "**loss**"


def jackknife(parts: np.ndarray, figure: Any) -> Interval:
    """Return a figure of all blocks, with its 95 % interval from leaving out each.

    Parameters
    ----------
    parts : ndarray, shape (blocks, ...)
        Sums of each block.
    figure : callable
        From the sum over blocks to the figure.
    """
    total, count = parts.sum(axis=0), len(parts)
    left = np.array([figure(total - part) for part in parts])
    error = np.sqrt((count - 1) / count * np.sum((left - left.mean()) ** 2))
    return Interval(figure(total), float(student.ppf(0.975, count - 1) * error))


def in_blocks(squares: Sequence[np.ndarray]) -> np.ndarray:
    """Return sums over `BLOCKS` blocks or so, shape (blocks, columns).

    Parameters
    ----------
    squares : sequence of ndarray, shape (samples, columns)
        One array for each recording; no block spans two of them.
    """
    lengths = np.array([len(s) for s in squares], dtype=float)
    counts = np.maximum(np.rint(BLOCKS * lengths / lengths.sum()), 2).astype(int)
    pairs = zip(squares, counts, strict=True)
    parts = [part.sum(axis=0) for s, n in pairs for part in np.array_split(s, n)]
    return np.array(parts)


def torque_squares(estimate: ci.Estimate, recording: ci.Recording) -> np.ndarray:
    """Return squares of each sample's error and torque, (samples, 2 torque joints)."""
    motion = motion_of(estimate.model, recording, None)
    error = motion.torque - motion.predicted(estimate.model, estimate.parameters)
    weights = 1.0 if motion.weights is None else motion.weights
    return np.hstack([(weights * error) ** 2, (weights * motion.torque) ** 2])


def torque_parts(
    estimates: Sequence[ci.Estimate], recordings: Sequence[ci.Recording]
) -> list[np.ndarray]:
    """Return each estimate's sums over blocks of the recordings."""
    return [in_blocks([torque_squares(e, r) for r in recordings]) for e in estimates]


def relative_error(model: ci.TorqueModel, sums: np.ndarray) -> float:
    """Return the relative error of all joints, from sums as `torque_parts` has them."""
    error, torque = np.split(sums, 2)
    return stacked_of_kinds(model, error, torque)


def torque_row(
    name: str, path: str, study: Study, judges: Sequence[ci.Recording], began: float
) -> list[str]:
    """Return the row of estimates judged by torque."""
    model, best = study.problem.model, study.recommendation.method
    methods = [*SHOWN, best]
    parts = torque_parts([study.estimate(method) for method in methods], judges)

    def figure(sums: np.ndarray) -> float:
        return relative_error(model, sums)

    errors = [jackknife(part, figure) for part in parts]
    both = np.stack([parts[-1], parts[0]], axis=1)
    less = jackknife(both, lambda sums: figure(sums[0]) - figure(sums[1]))
    expected = study.recommendation.expected
    said = "-"
    if expected is not None:
        inside = ""
        if not expected.contains(errors[-1].value):
            above = errors[-1].value > expected.high
            inside = ", **seen above**" if above else ", seen below"
        low, high = 100 * expected.low, 100 * expected.high
        said = f"{100 * expected.error:.2f} ({low:.2f} to {high:.2f}){inside}"
    reports = {r.estimate.method: r for r in study.comparison.reports}
    links = [sum(reports[m].consistent_links) for m in (Method.LEAST_SQUARES, best)]
    return [
        *(name, path, TORQUE),
        *(error.text(100.0) for error in errors),
        *(less.text(100.0), less.word, said),
        f"{links[0]} -> {links[1]} of {len(model.robot)}",
        *(str(study.verdict), f"{process_time() - began:.0f}"),
    ]


def rollout_row(name: str, path: str, problem: ci.Problem, began: float) -> list[str]:
    """Return the row of estimates judged by rollouts of the validation logs."""
    study = Study(problem)
    logs, gains = problem.logs("validation"), gains_of(problem)

    def parts(replays: Any) -> np.ndarray:
        squares = [r.errors**2 for r in replays]
        sums = [s.sum(axis=1, keepdims=True) for s in squares]
        ones = [np.full((len(s), 1), s.shape[1], dtype=float) for s in squares]
        return in_blocks([np.hstack(pair) for pair in zip(sums, ones, strict=True)])

    def replayed(method: str) -> np.ndarray | None:
        estimate = study.estimate(method)
        try:
            done = rollout(estimate, logs, gains, delay=problem.delay_of_commands)
        except ci.ConsistentIdError:
            return None  # MuJoCo has no body with such inertias, or the motion diverges
        return parts(next(iter(done.replays.values())))

    found = [replayed(method) for method in SHOWN]
    done = rollout_of(study, refine=True, choose=True)
    found.append(parts(next(iter(done.rollout.replays.values()))))

    def rms(sums: np.ndarray) -> float:
        return float(np.sqrt(sums[0] / sums[1]))

    cells = ["no rollout" if p is None else jackknife(p, rms).text(1e3) for p in found]
    less, word = "-", ""
    if found[0] is not None:
        both = np.stack([found[-1], found[0]], axis=1)
        gain = jackknife(both, lambda sums: rms(sums[0]) - rms(sums[1]))
        less, word = gain.text(1e3), gain.word
    reports = {r.estimate.method: r for r in study.comparison.reports}
    links = sum(reports[Method.LEAST_SQUARES].consistent_links)
    conditions = ci.constraints.link_conditions(
        done.estimate.model, done.estimate.parameters
    )
    consistent = sum(c.consistent for c in conditions)
    return [
        *(name, path, ROLLOUT, *cells, less, word, "-"),
        f"{links} -> {consistent} of {len(problem.model.robot)}",
        *(str(done.estimate.verdict), f"{process_time() - began:.0f}"),
    ]


def servo_row(entry: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the row of a hobby servo; its blocks are whole logs."""
    began = process_time()
    robot = ci.load_robot(*files([entry["robot"]], folder))
    training, judged = (
        read_servo_logs(files(entry[key], folder), robot.joint_names)
        for key in ("logs", "validate")
    )
    fit = identify_servos(robot, training, judged)
    each = [list(servo.validation[servo.chosen.name].values()) for servo in fit.joints]
    parts = np.column_stack([np.mean(each, axis=0), np.ones(len(judged))])
    error = jackknife(parts, lambda sums: float(sums[0] / sums[1]))
    return [
        *(entry["name"], "default", SERVO, *["-"] * len(SHOWN), error.text(1e3)),
        *("-", "", "-", "given bodies"),
        *(str(fit.verdict), f"{process_time() - began:.0f}"),
    ]


def rows(
    entry: Mapping[str, Any], folder: Path, _: list[list[str]]
) -> Iterator[list[str]]:
    """Yield the rows of an entry of the list; a path that is refused says why."""
    name = entry["name"]
    if entry.get("servo"):
        yield servo_row(entry, folder)
        return
    if "problem" not in entry:
        yield default_row(name, partial(draft_of_entry, entry, folder), None)
        return
    problem = ci.load_problem(folder / entry["problem"], trust=True)
    if problem.table.data is not None:
        base = entry.get("base")
        yield default_row(name, lambda: without_file(problem, base), problem)
    began = process_time()
    yield judged_row(name, "file", problem, None, began)


def draft_of_entry(entry: Mapping[str, Any], folder: Path) -> Draft:
    """Return the draft of a robot and logs of the list, which have no problem file."""
    given = {k: v for k, v in entry.items() if k not in ("name", "robot", "logs")}
    given["validation"] = files(given.pop("validate", ()), folder)
    (model,) = files([entry["robot"]], folder)
    return ci.draft_problem(model, files(entry["logs"], folder), **given)


def used_problems(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the problem files of the repository's list, for the page's digests."""
    named = (str(entry["problem"]) for entry in entries if "problem" in entry)
    return [name.removeprefix("../problems/") for name in named]


def default_row(
    name: str, drafted: Callable[[], Draft], judge: ci.Problem | None
) -> list[str]:
    """Return the row of a draft, judged as the problem file's own estimate is."""
    began = process_time()
    try:
        draft = drafted()
        by_torque = judge is not None and judge.table.data.gains is None
        judges = unseen(judge.validation, draft) if by_torque else None
        return judged_row(name, "default", draft.problem(), judges, began)
    except ci.ConsistentIdError as cause:
        return refused(name, "default", cause, began)


def judged_row(
    name: str,
    path: str,
    problem: ci.Problem,
    judges: Sequence[ci.Recording] | None,
    began: float,
) -> list[str]:
    """Return the row of a problem, by torque or by rollouts."""
    data = problem.table.data
    try:
        if data is not None and data.gains is not None:
            return rollout_row(name, path, problem, began)
        study = Study(problem)
        judges = study.validation if judges is None else judges
        return torque_row(name, path, study, judges, began)
    except ci.ConsistentIdError as cause:
        return refused(name, path, cause, began)


def refused(name: str, path: str, cause: Exception, began: float) -> list[str]:
    """Return the row of a path that ends with an error, with its sentence."""
    said = str(cause)
    for variable in ("CONSISTENT_ID_DATASETS", "EXAMPLE_ROBOT_DATA"):
        if folder := os.environ.get(variable):
            said = said.replace(folder, f"${{{variable}}}")
    cells = [f"refused: {said}", *["-"] * (len(HEADER) - 6)]
    return [name, path, "-", *cells, f"{process_time() - began:.0f}"]


def without_file(problem: ci.Problem, base: str | None) -> Draft:
    """Return the draft of a problem's model and logs."""
    data = problem.table.data
    if problem.gains is None:
        return bare_draft(problem)
    folder, model = problem.file(data.folder), problem.model_files["mjcf"]
    training = [entry for entry in data.recordings if entry.role == "training"]
    robot = ci.load_robot(model, base=base)
    still = set(robot.joint_names) - set(problem.model.robot.joint_names)
    return ci.draft_problem(
        model,
        list(dict.fromkeys(folder / entry.file for entry in training)),
        base=base,
        locked=dict.fromkeys(still, 0.0) or None,
        gains=problem.gains,
        bodies="model",
    )


def plates() -> str:
    """Return sentences on the person on force plates, who has no other recording."""
    data = person(Path(os.environ["CONSISTENT_ID_DATASETS"]))
    model, regression, base = data.rows
    plain = ci.least_squares(model, regression, base=base).parameters
    best = least_error(data)
    shown = {"least squares": plain, "best": best.parameters, **data.published}
    parts = {k: in_blocks([data.squares(x)[:, None]]) for k, x in shown.items()}

    def whole(sums: np.ndarray) -> float:
        return float(sums[0] / sums[1]) * len(data.measured)

    def text(tool: str, less: str | None = None) -> str:
        ones = in_blocks([np.ones((len(data.measured), 1))])
        other = parts[less] if less else 0.0
        return jackknife(np.hstack([parts[tool] - other, ones]), whole).text(1e-3)

    published = ", ".join(
        f"{kind} {text(kind)}, {text(kind, 'best')} more" for kind in data.published
    )
    return (
        "A person on force plates (16 bodies; one recording, so nothing is held out): "
        "weighted squared error, in thousands, of least squares "
        f"{text('least squares')}, of the best bodies within their ellipsoids "
        f"{text('best')} (optimum {best.optimality.verdict}), of the published "
        f"estimates, and how much more than of the best, {published}. Intervals are of "
        f"{BLOCKS} blocks, as above."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=Path, default=ROBOTS)
    parser.add_argument("--only", nargs="*", metavar="NAME", help="some of the list")
    add_resume(parser)
    parser.add_argument("--write", type=Path, help="page with marks of the table")
    options = parser.parse_args()
    entries = tomllib.loads(options.robots.read_text())["robot"]
    if options.only:
        entries = [entry for entry in entries if entry["name"] in options.only]
    folder, own = options.robots.parent, options.robots == ROBOTS
    used = used_problems(entries) if own else []
    kept = Kept(options.resume)
    with written_to(options.write, "table", used):
        print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}", flush=True)
        for entry in entries:
            measure = partial(rows, entry, folder)
            job = Job(entry["name"], "table", inputs_of(entry, folder), measure)
            for row in kept.done(job)[0]:
                print(f"| {' | '.join(row)} |", flush=True)
        if own and not options.only:
            print(f"\n{plates()}")


if __name__ == "__main__":
    main()
