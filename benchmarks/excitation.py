"""What designs of exciting trajectories reach, in what time, and whether it pays.

``python benchmarks/excitation.py [--minutes 10] [--write PAGE]``: all in one run on two
cores; the UR10e's recordings are in ``CONSISTENT_ID_DATASETS``.  ``--only "(d)"``
measures one section, and with ``--write`` renews that of the page.  ``--quick`` runs
everything for a moment, which proves nothing.  Section (d) has CMA-ES where ``cma`` is
installed, and FIGAROH with ``--figaroh PEERS/bin/python``, see ``peers/README.md``.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).parent))
import excitation_cases as cases
import excitation_designs as designs
import excitation_figaroh as figaroh
import excitation_montecarlo as montecarlo
import excitation_rivals as rivals
import excitation_timing as timing
from excitation_designs import Effort
from pages import stamp

FULL = Effort(
    seconds=10.0,
    short=3.0,
    minutes=10.0,
    seeds=20,
    repetitions=50,
    durations=tuple(cases.SERIES),
    methods=tuple(rivals.METHODS),
    patience=5.0,
)
QUICK = Effort(
    seconds=1.0,
    short=0.5,
    minutes=0.02,
    seeds=2,
    repetitions=3,
    durations=(20.0,),
    methods=("consistent_id", "random search"),
    patience=0.0,
)


def against_others(effort: Effort, figure: Path | None) -> Iterator[str]:
    """Yield (d): other optimisers on the same problem, and draw their traces."""
    case = cases.example("UR10")
    times = [share * effort.seconds for share in (0.1, 0.5, 1.5, 3.0)]
    yield "| method | " + " | ".join(f"{t:g} s" for t in times) + " |"
    yield "|---|" + "---:|" * len(times)
    traces, absent = [], {}
    for method in effort.methods:
        if wanted := rivals.missing(method):
            absent[method] = wanted
        else:
            traces.append(rivals.trace(method, case, times[-1]))
    if effort.figaroh:
        traces.append(figaroh.trace(effort.figaroh, case, times[-1]))
    else:
        absent[figaroh.NAME] = "`--figaroh PYTHON`"
    for one in traces:
        cells = " | ".join(f"{one.at(t):.1f}" for t in times)
        yield f"| {one.method} | {cells} |"
    for method, wanted in absent.items():
        yield f"| {method} | not run: needs {wanted} |" + " |" * (len(times) - 1)
    if figure:
        rivals.draw(traces, times[-1], figure)
        yield ""
        yield f"![Best condition numbers over time]({figure.name})"


def over_seeds(effort: Effort) -> Iterator[str]:
    """Yield (e): how much a single start is left to chance."""
    yield (
        "| robot | seeds | least | lower quartile | median | upper quartile | most "
        "| processor time of a start [s] |"
    )
    yield "|---|" + "---:|" * 7
    some = [cases.example("UR10"), cases.example("Panda"), cases.rx60()]
    if cases.recordings():
        some.append(cases.ur10e(20.0))
    for case in some:
        values, seconds = rivals.single_starts(case, effort.seeds)
        cells = " | ".join(
            f"{v:.3g}" for v in np.quantile(values, (0, 0.25, 0.5, 0.75, 1))
        )
        yield f"| {case.name} | {effort.seeds} | {cells} | {np.mean(seconds):.1f} |"


def pays(effort: Effort) -> Iterator[str]:
    """Yield the Monte-Carlo proof."""
    duration, noise = 20.0, np.array([0.16, 0.131, 0.159])  # Table VI, first row
    yield "### RX-60, 20 s, ten harmonics, noise of Table VI's first row"
    yield ""
    case = cases.rx60(duration)
    problem = cases.rx60_problem()
    others = {f"writing {n}": p for n, p in cases.writing_tasks(duration).items()}
    others["the paper's verification"] = problem.motion("verification")
    yield from _pays(case, others, problem.motion("held_out"), noise, effort)
    if not cases.recordings():
        return
    recorded, held_out = cases.recorded(30.0), cases.recorded(50.0)
    case = cases.ur10e(recorded.path.duration, friction=True)
    noise = cases.torque_noise()
    yield ""
    yield f"### UR10e with friction, {case.form.duration:.0f} s, noise as recorded"
    yield ""
    others = {"recorded, 12 harmonics (series)": recorded.path}
    yield from _pays(case, others, held_out.path, noise, effort)
    yield ""
    listed = ", ".join(f"{sigma:.2f}" for sigma in noise)
    yield (
        f"Noise: {listed} N m, what least squares leaves of the recorded torque; here "
        "it is white. Held out: the recorded 50 s motion."
    )


def _pays(case, others, held_out, noise, effort: Effort) -> Iterator[str]:
    yield montecarlo.HEADER

    def tried(path):
        return montecarlo.scatter(case, path, held_out, noise)

    random = [cases.random_path(case, seed) for seed in range(9)]
    reference = [tried(path) for path in random]
    made = designs.designed(case, effort.seconds, effort, refine="D", noise=noise)
    motions = dict(others)
    for stage, name in zip(
        made.design.stages, ("least condition number", "then D-optimal"), strict=False
    ):
        motions[f"designed, {name}"] = stage.trajectory
    conditions = [cases.condition(case, path) for path in random]
    best = int(np.argmin(conditions))
    yield montecarlo.row(
        "random, the best condition of 9", conditions[best], reference[best], reference
    )
    for name, path in motions.items():
        W = montecarlo.regressor(case, path)
        condition = np.linalg.cond(W.reshape(-1, W.shape[2]))
        yield montecarlo.row(name, condition, tried(path), reference)


@dataclass(frozen=True)
class Section:
    """A section of the page, and how its lines are measured."""

    title: str
    about: str
    lines: Callable[[], Iterable[str]]

    def measured(self) -> str:
        """Return its text, with the day, the commit and the machine."""
        found = "\n".join(self.lines())
        when = f"Measured{stamp()}."
        return f"## {self.title}\n\n{when}\n{self.about}\n\n{found}\n"


def sections(effort: Effort, figure: Path | None) -> list[Section]:
    """Return all sections, the first only where there are recordings."""
    recorded = Section(
        "(a) UR10e: against its recorded motions",
        ABOUT_RECORDED,
        lambda: [
            *designs.against_recordings(effort),
            "",
            designs.ten_minutes(effort),
        ],
    )
    return [
        *([recorded] if cases.recordings() else []),
        Section(
            "(b) RX-60: against writing and the paper's verification motion",
            ABOUT_RX60,
            lambda: designs.against_writing(effort),
        ),
        Section("(c) UR10 and Panda", ABOUT_EXAMPLES, lambda: designs.examples(effort)),
        Section(
            "(d) The same problem put to other optimisers",
            ABOUT_OTHERS,
            lambda: against_others(effort, figure),
        ),
        Section(
            "(e) Single starts from many seeds",
            ABOUT_SEEDS,
            lambda: over_seeds(effort),
        ),
        Section(
            "(f) One objective with its gradient",
            ABOUT_TIMES,
            lambda: [timing.HEADER, *timing.rows(effort.repetitions)],
        ),
        Section("Does it pay?", ABOUT_PAYING, lambda: pays(effort)),
    ]


ABOUT_RECORDED = """\
Same duration, number of harmonics (12), base columns and sampling (100 Hz) for all;
periodic paths, limits as the data set's `meta.json` and the URDF's speeds. Recorded
motions are given as the series fitted between two standstills, and as the recorded
samples. Designs keep all limits at all times, by proof. The recorded motions exceed
some limits, as listed below the table."""
ABOUT_RX60 = """\
10 s, five harmonics, from rest to rest; 15 base columns of the first three joints.
The paper gives no joint limits: ranges of 160, 127.5 and 134.5 degrees to both sides
and speeds of 287, 287 and 319 degrees/s are assumptions of this page. The size of its
writing is not given either: here the wrist draws within 0.12 m, in 10 s."""
ABOUT_EXAMPLES = """\
10 s, five harmonics, from rest to rest, limits of the URDFs, base columns unscaled.
Published: 121.9 for the motion of the Panda's authors, 94 to 106 for the WAM, and
116.7 that robot_payload_id reports after 100 000 evaluations; their robots, bases,
limits and scalings differ, so these numbers are not comparable."""
ABOUT_OTHERS = """\
UR10, 10 s, five harmonics, rest to rest, 54 variables, the least condition number
found up to each time. All methods search in the same variables. All candidates are
scaled into the limits and measured in the same way, at the same 100 samples. All
methods have two processes. Times are processor times of each process, so 15 s are 30
s in total, and other work of the machine does not count. FIGAROH runs in a separate
environment. It searches for splines that rest every 2 s, its default, in 30
variables, by finite differences. Its limits of torque and collisions are off, as in
the other methods, and all its paths are measured like the others. This is one run
with two seeds; other runs end with other numbers, as in (e)."""
ABOUT_SEEDS = """\
The condition number that a single search reaches from its random path, at its own 100
samples (UR10e: 20 s, 12 harmonics, periodic; others as above)."""
ABOUT_TIMES = """\
One thread; the smooth condition number with its gradient in all variables, compared
with the objective alone, and with the objective as often as forward differences need
it. The rows are the Panda with its last joints locked, then the UR10 with more
samples, then with more harmonics (3, 5, 10 and 20). Each time is the least of many."""
ABOUT_PAYING = """\
Weighted least squares on simulated recordings of equal length, rate and noise, 500
draws of the noise. Standard errors of the base parameters are relative to the median
over 9 random paths that use the whole limits. The torque error is that of predictions
on another motion. Condition numbers are those of unscaled, unweighted base columns.
Designs were made for the stated noise."""


INTRODUCTION = """\
# Evidence for designed trajectories

Measured by `python benchmarks/excitation.py`, each section on the day that it names,
on a shared machine with two processors. *Busy before* is the number of processors
that did other work when a timed part began. If it is above 0, an idle machine would
have found better designs. `--only "(d)"` measures one section again.

A condition number depends on the columns, their scaling and the samples; each table
states them, and compares only equal ones. *Unit columns* are scaled by their size on
the path itself, which hides joints that hardly move.
"""


def page(found: list[Section]) -> str:
    """Return the evidence as Markdown."""
    texts = [one.measured() for one in tqdm(found, unit="section")]
    return "\n".join([INTRODUCTION, *texts])


def renewed(old: str, found: list[Section]) -> str:
    """Return a page with some sections measured again."""
    heading = "\n## "
    introduction, *kept = old.split(heading)
    anew = {one.title: one.measured().removeprefix("## ") for one in tqdm(found)}
    texts = [anew.get(text.splitlines()[0], text) for text in kept]
    return heading.join([introduction, *texts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, help="of the long search")
    parser.add_argument("--quick", action="store_true", help="everything for a moment")
    parser.add_argument("--only", help="sections whose titles begin so")
    parser.add_argument("--figaroh", help="Python of an environment that has it")
    parser.add_argument("--write", type=Path, help="file to write the page to")
    options = parser.parse_args()
    effort = replace(QUICK if options.quick else FULL, figaroh=options.figaroh)
    if options.minutes is not None:
        effort = replace(effort, minutes=options.minutes)
    figure = options.write.with_suffix(".png") if options.write else None
    found = sections(effort, figure)
    found = [one for one in found if one.title.startswith(options.only or "")]
    if options.write and options.write.exists():  # it has sections of other commands
        text = renewed(options.write.read_text(), found)
    else:
        text = page(found)
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()
