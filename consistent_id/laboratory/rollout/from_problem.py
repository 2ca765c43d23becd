"""A problem's rollout: its torque fit, perhaps refined, replayed beside others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table
from consistent_id.comparison.block_scatter import BLOCKS, BlockScatter, block_scatter
from consistent_id.comparison.comparison import compare
from consistent_id.comparison.speed_trend import (
    TrendAt,
    joint_speeds,
    speed_of,
    speed_trend,
)
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.estimate import Estimate
from consistent_id.laboratory.rollout.format_form import in_form_of
from consistent_id.laboratory.rollout.refine import RIDGE, Refined, refined
from consistent_id.laboratory.rollout.ridge import chosen_ridge
from consistent_id.laboratory.rollout.rollout import Rollout, rollout
from consistent_id.laboratory.rollout.settings import (
    gains_of,
    rollout_error,
    torque_fit,
    with_settings,
)
from consistent_id.laboratory.rollout.settings_choice import (
    SettingsChoice,
    chosen_settings,
)
from consistent_id.problems.problem import Problem
from consistent_id.regression.segments import segment_regressions, segments_of


class FormLoss(NamedTuple):
    """What the form of friction of a format costs.

    Parameters
    ----------
    before, after : float, [rad or m]
        Error of rollouts of the torque fit as the problem states it, less what MuJoCo
        lacks, and fitted in the form of the format.
    """

    form: str
    before: float
    after: float

    def table(self) -> Table:
        """Return the loss, for people."""
        title = (
            f"Friction fitted again in the form of {self.form}: error of rollouts "
            f"{1e3 * self.before:.2f} to {1e3 * self.after:.2f} mrad (mm)"
        )
        notes = ("before: as the problem states it, less what MuJoCo lacks",)
        return Table(title, (), (), notes)


@dataclass(frozen=True, slots=True, eq=False)
class ProblemRollout:
    """What a problem's commands make of its estimate.

    Parameters
    ----------
    problem : Problem
        With the settings that were chosen, if they were.
    rollout : Rollout
        Of the validation logs, or of the training logs if there are no others.
    scatter : BlockScatter, optional
        How sure the torque fit's parameters are; None where blocks of the training
        motion do not determine them by themselves.
    trend : TrendAt, optional
        What to expect of parameters at the speed of the replayed motion; None where
        blocks are alike in speed.
    form : FormLoss, optional
        If friction was fitted in the form of a format.
    """

    problem: Problem
    estimate: Estimate
    rollout: Rollout
    settings: SettingsChoice | None = None
    refinement: Refined | None = None
    scatter: BlockScatter | None = None
    trend: TrendAt | None = None
    form: FormLoss | None = None

    def tables(self) -> list[Table]:
        """Return what was found, for people."""
        verdict = self.estimate.verdict
        verdict_table = Table(verdict.sentence, (), (), verdict.lines)
        tables = [verdict_table, *self.rollout.tables()]
        if self.form is not None:
            tables.append(self.form.table())
        if self.settings is not None:
            tables.append(self._settings_table(self.settings))
        tables += self.problem.drives.tables()
        if self.scatter is not None:
            tables.append(self.scatter.table())
        if self.trend is not None:
            tables.append(self.trend.table())
        return tables

    def _settings_table(self, choice: SettingsChoice) -> Table:
        s = choice.settings
        cells = {
            "cut-off [Hz]": f"{s.cutoff:g}",
            "velocity scale": f"{s.velocity_scale:g}",
            "friction slope of": ", ".join(s.friction_slope) or "none",
            "delay [ms]": f"{1e3 * s.delay:g}",
            "springs [N m/rad]": self._springs(),
        }
        note = (
            f"error on the other part {1e3 * choice.error:.2f} mrad (mm), the least of "
            f"{len(choice.tried)}"
        )
        title = "Settings chosen on parts of the training motion"
        return Table(title, tuple(cells), (tuple(cells.values()),), (note,))

    def _springs(self) -> str:
        joints = self.problem.model.robot.joint_names
        stiffness = gains_of(self.problem).of(len(joints)).stiffness
        named = ", ".join(
            f"{joint} {k:.3g}"
            for joint, k in zip(joints, stiffness.tolist(), strict=True)
            if np.isfinite(k)
        )
        return named or "none"

    def to_dict(self) -> dict[str, Any]:
        """Return what was found by name, for JSON."""
        record = {**self.estimate.verdict.to_dict(), **self.rollout.to_dict()}
        if self.refinement is not None:
            record["refined"] = {
                "training_error_before": self.refinement.before,
                "training_error_after": self.refinement.after,
            }
        if self.form is not None:
            record["form"] = self.form._asdict()
        if self.scatter is not None:
            record["parameters"] = self.scatter.to_dict()
        if self.trend is not None:
            record["parameters_at_speed"] = self.trend.to_dict()
        if self.settings is not None:
            s = self.settings.settings
            record["settings"] = {
                "cutoff": s.cutoff,
                "velocity_scale": s.velocity_scale,
                "friction_slope": list(s.friction_slope),
                "delay": s.delay,
                "stiffness": {
                    joint: k
                    for joint, k in zip(
                        self.problem.model.robot.joint_names,
                        s.stiffness or (),
                        strict=False,
                    )
                    if np.isfinite(k)
                },
                "error": self.settings.error,
            }
        return record


def rollout_of(
    problem: Problem,
    *,
    against: Sequence[str | Path] = (),
    refine: bool = False,
    choose: bool = False,
    form: str | None = None,
    accepted: Sequence[str] = (),
) -> ProblemRollout:
    """Fit a problem's torques, and replay its commands.

    Parameters
    ----------
    problem : Problem
        With gains of its drives.
    against : sequence of str or Path
        MJCF or URDF files of the robot.
    refine : bool
        Refine the estimate on rollouts of the training logs.
    choose : bool
        Choose cut-off, delay and shape of friction on the training logs; and whether to
        refine, and how far, if it is to be refined.
    form : str, optional
        Fit friction in the form that a file format has; see `in_form_of`.
    accepted : sequence of str
        Kinds of reasons that the verdict is to overlook.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    ModelError
        If MuJoCo is not installed, or refuses a robot.
    RecordingError
        If a motion diverges.
    """
    choice = chosen_settings(problem) if choose else None
    if choice is not None:
        problem = with_settings(problem, choice.settings)
    stated = problem
    if form is not None:
        problem = in_form_of(problem, form)
    gains = gains_of(problem)
    estimate, regression = torque_fit(problem)
    loss = None if form is None else _loss(stated, problem, estimate, form)
    training, delay = problem.logs("training"), problem.delay_of_commands
    done = None
    ridge = _ridge(problem, refine, choose)
    if ridge is not None:
        done = refined(
            estimate,
            regression,
            training,
            gains,
            constraints=problem.constraints,
            delay=delay,
            ridge=ridge,
        )
        estimate = done.estimate
    own = replace(estimate, accepted=tuple(accepted))
    judged = compare([own], problem.validation).reports[0].judged
    replays = rollout(
        judged,
        problem.logs("validation") or training,
        gains,
        against=against,
        training=training,
        delay=delay,
        locked=problem.table.model.locked,
    )
    scatter, trend = _sureness(problem, regression.sigma)
    return ProblemRollout(problem, judged, replays, choice, done, scatter, trend, loss)


def _loss(stated: Problem, formed: Problem, estimate: Estimate, form: str) -> FormLoss:
    logs = stated.logs("validation") or stated.logs("training")
    before = rollout_error(stated, torque_fit(stated)[0], logs)
    return FormLoss(form, before, rollout_error(formed, estimate, logs))


def _sureness(
    problem: Problem, sigma: Vector
) -> tuple[BlockScatter | None, TrendAt | None]:
    """Return how sure parameters are: of the training motion, and at another speed."""
    model, training = problem.model, problem.training
    blocks = segment_regressions(model, training, count=BLOCKS, sigma=sigma)
    known = problem.constraints
    try:
        scatter = block_scatter(model, blocks, constraints=known)
    except NotExcitedError:
        return None, None
    try:
        single = [block_scatter(model, [block], constraints=known) for block in blocks]
        scale = joint_speeds(training)
        pieces = segments_of(training, count=BLOCKS)
        trend = speed_trend(single, [speed_of([piece], scale) for piece in pieces])
    except NotExcitedError:
        return scatter, None
    return scatter, TrendAt(trend, speed_of(problem.validation or training, scale))


def _ridge(problem: Problem, refine: bool, choose: bool) -> float | None:
    """Return the weight of the torque fit in a refinement; None for no refinement."""
    if not refine:
        return None
    return chosen_ridge(problem).ridge if choose else RIDGE
