"""A study's rollout: its recommended estimate, or one refined, beside other robots."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.given_values import require_type
from consistent_id._support.progress import stages
from consistent_id._support.tables import Table, brief
from consistent_id.comparison.speed_trend import (
    TrendAt,
    joint_speeds,
    speed_of,
    speed_trend,
)
from consistent_id.errors import ConsistentIdError, NotExcitedError, RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.uncertainties.block_scatter import (
    BLOCKS,
    BlockScatter,
    block_scatter,
)
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.problems.problem import Problem
from consistent_id.problems.study import Study
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.segments import segment_regressions, segments_of
from consistent_id.rollout.chosen_settings import (
    SettingsChoice,
    chosen_settings,
    motor_sentence,
)
from consistent_id.rollout.compared_models import Rollout, rollout
from consistent_id.rollout.delay_interval import (
    damping_sentence,
    delay_sentence,
    delay_words,
    without_rests,
)
from consistent_id.rollout.delay_search import FoundDelay
from consistent_id.rollout.delivered_parameters import (
    delivered_parameters,
    parameter_table,
)
from consistent_id.rollout.faded_friction import hidden_friction, hidden_notes
from consistent_id.rollout.refine import Refined, refined
from consistent_id.rollout.refinement_choice import RidgeChoice, chosen_ridge
from consistent_id.rollout.settings import (
    gains_of,
    in_form_of,
    rollout_error,
    torque_fit,
    with_settings,
    without_friction,
)

FORMAT = "consistent_id rollout 1"
"""Format of `ProblemRollout.to_dict`."""


class FormLoss(NamedTuple):
    """The cost of a format's form of friction.

    Parameters
    ----------
    before, after : float, [rad or m]
        Error of rollouts of the recommended estimate as the problem states it, less
        what MuJoCo lacks, and fitted in the form of the format.
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
        notes = ("before: as the problem states it, without terms that MuJoCo lacks",)
        return Table(title, (), (), notes)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ProblemRollout:
    """A replay of a problem's commands, with the verdict on the replayed estimate.

    Parameters
    ----------
    study : Study
        The study of the problem, with the chosen settings, if they were chosen.
    estimate : Estimate
        The one that the study recommends, with its verdict there; or the refined one.
    rollout : Rollout
        Rollout of the validation logs, or of the training logs if there are no others.
    scatter : BlockScatter, optional
        Uncertainty of a torque fit's parameters; None if blocks of the training motion
        do not determine them.
    trend : TrendAt, optional
        Predicted parameters at the speed of the replayed motion; None if blocks have
        similar speeds.
    form : FormLoss, optional
        If friction was fitted in the form of a format.
    ridge : RidgeChoice, optional
        The choice of the refinement, if one was requested; a refinement that predicts
        worse is not taken.
    notes : tuple of str
        Why settings are as stated, or the estimate is not refined, though that was
        asked.
    """

    study: Study
    estimate: Estimate
    rollout: Rollout
    settings: SettingsChoice | None = None
    refinement: Refined | None = None
    ridge: RidgeChoice | None = None
    scatter: BlockScatter | None = None
    trend: TrendAt | None = None
    form: FormLoss | None = None
    notes: tuple[str, ...] = ()

    @property
    def problem(self) -> Problem:
        """The study's problem."""
        return self.study.problem

    def tables(self) -> list[Table]:
        """Return the results for people."""
        verdict = self.estimate.verdict
        choice, late = self.settings, list[str]()
        if choice is not None and choice.delay is not None:
            late.append(delay_words(choice.delay, choice.delay_interval))
        if choice is not None and choice.settings.bodies is not None:
            late.append(
                "bodies are those of the robot's file: with identified ones, motion "
                'that was left out is not predicted better; bodies = "identified" '
                "(--bodies identified) keeps these"
            )
        lines = (self.rollout.sentence, *late, *verdict.lines)
        verdict_table = Table(verdict.sentence, (), (), lines)
        tables = [verdict_table, *self.rollout.tables()]
        tables += [Table(note, (), (), ()) for note in self.notes]
        if self.form is not None:
            tables.append(self.form.table())
        if self.settings is not None:
            tables.append(self._settings_table(self.settings))
        if self.ridge is not None:
            tables.append(self._refinement_table(self.ridge))
        tables += self.problem.drives.tables()
        if self.scatter is not None:
            tables.append(parameter_table(self.estimate, self.scatter))
        if self.trend is not None:
            tables.append(self.trend.table())
        return tables

    def _settings_table(self, choice: SettingsChoice) -> Table:
        s = choice.settings
        cells = {
            "cut-off [Hz]": f"{s.cutoff:g}",
            "velocity scale": f"{s.velocity_scale:g}",
            "friction slope of": ", ".join(s.friction_slope) or "none",
            "delay [ms]": f"{1e3 * s.delay:.2f}",
            "springs [N m/rad]": self._springs(),
        }
        notes = [
            f"error on the other part {1e3 * choice.error:.2f} mrad (mm); of "
            f"{len(choice.tried)} settings, these are the best with joints alike"
        ]
        if choice.delay is not None:
            rested = without_rests(self.problem, s)
            found, interval = choice.delay, choice.delay_interval
            notes.append(delay_sentence(found, interval, rested=rested))
            names = self.problem.model.robot.joint_names
            notes.append(damping_sentence(gains_of(self.problem), names))
        stated = self.problem.table.constraints.equal_motors
        if motors := motor_sentence(choice, stated):
            notes.append(motors)
        if s.least_joint_speed is not None:
            notes.append(
                f"rows of joints slower than {s.least_joint_speed:g} rad/s (m/s) are "
                "left out, and around reversals: friction there may have any value"
            )
        if s.simulated:
            notes.append("only drive terms that MuJoCo has")
        if s.spring is not None:
            which = "each" if s.spring else "no"
            notes.append(f"{which} joint has a spring in its torque")
        if not s.couplings:
            notes.append(
                "without the problem's coupled gears, which do not predict better"
            )
        notes += [f"not tried: {reason}" for reason in choice.skipped]
        title = "Settings chosen on parts of the training motion"
        return Table(title, tuple(cells), (tuple(cells.values()),), tuple(notes))

    def _refinement_table(self, choice: RidgeChoice) -> Table:
        if choice.reason is not None:
            title = f"Refinement by rollout is not possible: {choice.reason}"
            return Table(title, (), (), ())
        steps = {r: e for r, e in choice.errors.items() if r is not None}
        what, step = "taken", steps.get(choice.ridge or 0.0, min(steps.values()))
        if choice.ridge is None:
            what = "not taken: by joint, it predicts a part worse, or none better"
        plain, least = (
            f"{1e3 * error:.2f} mrad (mm)" if np.isfinite(error) else "infinite"
            for error in (choice.errors[None], step)
        )
        title = (
            f"Refinement by rollout is {what}; error on the other part {plain} "
            f"without, {least} with one step"
        )
        if len(choice.cutoffs) < 2 or choice.cutoff is None:
            return Table(title, (), (), ())
        errors = ", ".join(
            f"{1e3 * error:.2f} from {cutoff:g} Hz"
            for cutoff, error in choice.cutoffs.items()
        )
        note = (
            f"refined from the torque fit with a cut-off of {choice.cutoff:g} Hz, the "
            "lowest with which the other part's error, by joint, is not surely larger "
            f"than with {next(iter(choice.cutoffs)):g} Hz: {errors}"
        )
        return Table(title, (), (), (note,))

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
        """Return the results by name, for JSON."""
        given = None if self.refinement is None else self.estimate.verdict
        record = {
            "format": FORMAT,
            **self.study.answer(given),
            **self.rollout.to_dict(),
        }
        if self.notes:
            record["notes"] = list(self.notes)
        if self.refinement is not None:
            record["refined"] = {
                "training_error_before": self.refinement.before,
                "training_error_after": self.refinement.after,
            }
        if self.form is not None:
            record["form"] = self.form._asdict()
        if self.scatter is not None:
            record["parameters"] = delivered_parameters(self.estimate, self.scatter)
        if self.trend is not None:
            record["parameters_at_speed"] = self.trend.to_dict()
        if self.settings is not None:
            s = self.settings.settings
            record["settings"] = {
                "cutoff": s.cutoff,
                "velocity_scale": s.velocity_scale,
                "friction_slope": list(s.friction_slope),
                "delay": s.delay,
                "delay_error": _known(self.settings.delay),
                "delay_interval": _listed(self.settings.delay_interval),
                "equal_motors": [list(group) for group in s.equal_motors or ()],
                "simulated_terms_only": s.simulated,
                "spring": s.spring,
                "couplings": s.couplings,
                "least_joint_speed": s.least_joint_speed,
                "bodies": s.bodies,
                "skipped": list(self.settings.skipped),
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


def _known(found: FoundDelay | None) -> float | None:
    return None if found is None or not np.isfinite(found.error) else found.error


def _listed(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def rollout_of(
    study: Study,
    *,
    against: Sequence[str | Path] = (),
    refine: bool = False,
    choose: bool = False,
    form: str | None = None,
    progress: bool = False,
) -> ProblemRollout:
    """Replay a problem's commands by the estimate that its study recommends.

    Parameters
    ----------
    study : Study
        Study of a problem with gains of its drives; only its needed parts are computed.
    against : sequence of str or Path
        MJCF or URDF files of the robot.
    refine : bool
        Refine the weighted constrained estimate on rollouts of the training logs, and
        replay that one, unless it predicts the part of the training logs worse that it
        was not learnt from.
    choose : bool
        Choose cut-off, delay, shape of friction and equal motors on the training logs.
        The study is that of the problem with these settings; or as stated, if none can
        be chosen.
    form : str, optional
        Fit friction in the form that a file format has; see `in_form_of`.  The study is
        that of the problem with this friction.
    progress : bool
        Show which stage is under way, on the standard error.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    ModelError
        If MuJoCo is not installed, or refuses a robot.
    RecordingError
        If a motion diverges, also with the stated settings and without refinement.
    """
    require_type(study, Study, "study")
    gains_of(study.problem)  # before the work, as MuJoCo
    require_mujoco()
    with stages(4, progress) as begin:
        choice, notes = None, []
        if choose:
            begin("cut-off, delay and friction")
            try:
                choice = chosen_settings(study.problem, refine=refine)
            except ConsistentIdError as reason:
                notes.append(f"Settings are as stated: {reason}")
        ways = dict.fromkeys([(choice, refine), (choice, False), (None, False)])
        *better, last = ways
        for settings, refining in better:
            try:
                done = _rolled(study, settings, refining, against, form, begin)
            except (RecordingError, NotExcitedError) as reason:
                what = "not refined" if refining else "not with the chosen settings"
                notes.append(f"The replayed estimate is {what}: {reason}")
            else:
                return replace(done, notes=(*notes, *done.notes))
        done = _rolled(study, *last, against, form, begin)
    return replace(done, notes=(*notes, *done.notes))


def _rolled(
    study: Study,
    choice: SettingsChoice | None,
    refine: bool,
    against: Sequence[str | Path],
    form: str | None,
    begin: Callable[[str], None],
) -> ProblemRollout:
    """Replay with these settings; see `rollout_of`."""
    if choice is not None:
        study = replace(study, problem=with_settings(study.problem, choice.settings))
    stated = study
    if form is not None:
        study = replace(study, problem=in_form_of(study.problem, form))
    # Friction in a format's form is fitted with the settings as they were chosen.
    settings = None if choice is None or form is not None else choice.settings
    if refine:
        begin("how far to refine")
    ridge = chosen_ridge(study.problem, settings) if refine else None
    if choice is not None and ridge is not None and ridge.cutoff is not None:
        choice = replace(choice, settings=replace(choice.settings, cutoff=ridge.cutoff))
        study = replace(study, problem=with_settings(study.problem, choice.settings))
    notes: tuple[str, ...] = ()
    if choice is not None:
        study, notes = _as_rows_show(study)
    problem, gains = study.problem, gains_of(study.problem)
    begin("fit and verdict")
    estimate, done, ridge = _delivered(study, gains, ridge)
    loss = None if form is None else _loss(stated, study, form)
    begin("rollouts")
    training = problem.logs("training")
    replays = rollout(
        estimate,
        problem.logs("validation") or training,
        gains,
        against=against,
        training=training,
        delay=problem.delay_of_commands,
        locked=problem.table.model.locked,
    )
    sureness = _sureness(study)
    return ProblemRollout(
        study,
        estimate,
        replays,
        choice,
        done,
        ridge,
        *sureness,
        loss,
        notes,
    )


def _as_rows_show(study: Study) -> tuple[Study, tuple[str, ...]]:
    """Return a study without Stribeck friction that rows do not show, and a note."""
    hidden = hidden_friction(study)
    if not hidden:
        return study, ()
    problem = without_friction(study.problem, hidden)
    return replace(study, problem=problem), hidden_notes(hidden)


def _delivered(
    study: Study, gains: PDGains, ridge: RidgeChoice | None
) -> tuple[Estimate, Refined | None, RidgeChoice | None]:
    """Return the refined estimate, or else the recommended one, with its verdict."""
    if ridge is not None and ridge.ridge is not None:
        try:
            done = _refined(study, gains, ridge.ridge)
        except ConsistentIdError as reason:
            ridge = replace(ridge, ridge=None, reason=str(reason))
        else:
            judged = study.verdict_on(done.estimate)
            return replace(done.estimate, judged=judged), done, ridge
    return study.run(costs=False).recommended.with_verdict, None, ridge


def _refined(study: Study, gains: PDGains, ridge: float) -> Refined:
    """Refine the torque fit that is nearest to rollouts: of joints weighted by noise.

    It accepts what the study does.
    """
    problem = study.problem
    start, regression = torque_fit(problem)
    return refined(
        replace(start, accepted=study.accepted),
        regression,
        problem.logs("training"),
        gains,
        constraints=problem.constraints,
        delay=problem.delay_of_commands,
        ridge=ridge,
    )


def _loss(stated: Study, formed: Study, form: str) -> FormLoss:
    method = formed.recommendation.method
    logs = stated.problem.logs("validation") or stated.problem.logs("training")
    before, after = (
        rollout_error(study.problem, study.estimate(method), logs)
        for study in (stated, formed)
    )
    return FormLoss(form, before, after)


def _sureness(study: Study) -> tuple[BlockScatter | None, TrendAt | None]:
    """Return the uncertainty of parameters for training motion and at another speed."""
    problem = study.problem
    model, training = problem.model, problem.training
    sigma = joint_noise(model, study.regression, base=study.base)
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
