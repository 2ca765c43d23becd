"""What ``identify robot.urdf log`` reaches beside a hand-made problem file.

The bare call gets the logs, column names, gains and torque joints of the file, and no
more.  Both recommended estimates are judged by the file's validation recordings,
prepared as the file says, without what the bare call learnt from.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import consistent_id as ci
from consistent_id.estimation.method import Method
from consistent_id.problems.draft import Draft
from consistent_id.problems.selection.choice import data_of
from consistent_id.problems.study import Study
from consistent_id.recordings.signals import trimmed
from consistent_id.regression.residual_noise import joint_noise

COLUMNS = (
    "robot",
    "hand-made file [%]",
    "bare [%]",
    "verdict on the bare one",
    "chosen",
)
HAND_MADE = Path(__file__).parent / "hand_made"
_CHANNELS = ("position", "velocity", "torque")


def bare(name: str) -> list[str]:
    """Return the row of a robot."""
    hand = ci.load_problem(HAND_MADE / f"{name}.toml", trust=True)
    try:
        draft = bare_draft(hand)
        study = Study(draft.problem())
        verdict = study.verdict
    except ci.ConsistentIdError as cause:
        return [name, "", "", f"refused: {cause}", ""]
    judges = unseen(hand.validation, draft)
    estimates = (recommended(Study(hand)), study.recommended.with_verdict)
    errors = [_errors(estimate, judges) for estimate in estimates]
    kinds = ", ".join(dict.fromkeys(reason.kind for reason in verdict.grounds))
    selection = draft.selection
    steps = () if selection is None else selection.steps
    chosen = "; ".join(step.move.label for step in steps) or "nothing"
    return [name, *errors, f"{verdict} ({kinds})" if kinds else str(verdict), chosen]


def bare_draft(hand: ci.Problem) -> Draft:
    """Draft the problem of a file's logs, with what the bare call is told."""
    data = data_of(hand.table)
    folder = hand.file(data.folder)
    training, held_out = (
        dict.fromkeys(folder / r.file for r in data.recordings if r.role == role)
        for role in ("training", "validation")
    )
    named = {channel: getattr(data.columns, channel) for channel in _CHANNELS}
    return ci.draft_problem(
        hand.model_files["urdf"],
        list(training),
        validation=[file for file in held_out if file not in training],
        **{channel: name for channel, name in named.items() if name},
        torque_joints=data.torque_joints,
        torque_gain=np.atleast_1d(data.torque_gain).tolist(),
        locked=_held(hand),
    )


def unseen(
    recordings: Sequence[ci.Recording], draft: Draft
) -> tuple[ci.Recording, ...]:
    """Return prepared recordings without what a draft has for training."""
    ends = {
        entry.log.stem: draft.raw[entry.log].time[entry.rows[1] - 1]
        for entry in draft.recordings
        if entry.role == "training"
    }
    return tuple(
        trimmed(recording, ends.get(Path(recording.name).stem, -np.inf))
        for recording in recordings
    )


def recommended(study: Study) -> ci.Estimate:
    """Return the recommended estimate; nothing else of a study is computed."""
    method = Method(study.recommendation.method)
    regression = study.regression
    if method == Method.WEIGHTED_CONSTRAINED:
        sigma = joint_noise(study.problem.model, regression, base=study.base)
        regression = regression.weighted(sigma)
    return ci.constrained_least_squares(
        study.problem.model,
        regression,
        constraints=study.problem.constraints,
        prior=study.priors[method],
        base=study.base,
    )


def _errors(estimate: ci.Estimate, judges: Sequence[ci.Recording]) -> str:
    return "; ".join(f"{100 * estimate.score(j).stacked:.2f}" for j in judges)


def _held(hand: ci.Problem) -> dict[str, float] | None:
    """Return what stands still, if the file moves a part of the robot."""
    moving = hand.table.model.joints
    if moving is None:
        return None
    every = ci.load_robot(hand.model_files["urdf"]).joint_names
    return dict.fromkeys(set(every) - set(moving), 0.0)
