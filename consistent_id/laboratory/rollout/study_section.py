"""A section of a study's report: its commands, replayed by what it recommends."""

from consistent_id.errors import ModelError, RecordingError
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.laboratory.rollout.rollout import rollout
from consistent_id.laboratory.rollout.rollout_page import rollout_body
from consistent_id.problems.study import Study
from consistent_id.report.markup import tag
from consistent_id.report.report_content import Section


def rollout_section(study: Study) -> tuple[Section, ...]:
    """Return the section on rollouts; none without commands, gains and MuJoCo.

    The recommended estimate is replayed beside the problem's own file of the robot.
    """
    problem = study.problem
    gains = problem.gains
    if gains is None:
        return ()
    try:
        require_mujoco()
    except ModelError:
        return ()
    training = problem.logs("training")
    try:
        done = rollout(
            study.comparison[study.verdict.method].judged,
            problem.logs("validation") or training,
            gains,
            against=[file for file in problem.model_files.values() if file is not None],
            training=training,
            delay=problem.delay_of_commands,
            locked=problem.table.model.locked,
        )
    except (ModelError, RecordingError) as cause:
        body = tag("p", f"Commands could not be replayed: {cause}")
        return (Section("rollouts", "Rollouts", body),)
    return (Section("rollouts", "Rollouts", rollout_body(done)),)
