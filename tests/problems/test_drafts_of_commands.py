"""Logs of commands are drafted with gains: several of them, with a model selected."""

import numpy as np
import pytest
from msgspec import structs

from consistent_id import ProblemError, TorqueModel, draft_problem
from consistent_id.cli import main
from consistent_id.diagnosis.coverage import saturation_findings
from consistent_id.problems.drafting import DRY
from consistent_id.problems.loading import problem_of
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import Statement
from consistent_id.robot import load_urdf
from consistent_id.signals import PDGains, commanded
from tests.helpers.logged import DRIVE, URDF, moved

GAINS = PDGains([60.0, 40.0], [2.0, 1.0])


def commanded_logs(folder, *tempos, late=0.0):
    """Write a robot, and logs of the commands that make its motions.

    A drive holds a command, so that the torque at a sample is half that of the command
    before: commands are made half a step early, and earlier by what they are late [s].
    """
    urdf = folder / "arm.urdf"
    urdf.write_text(URDF)
    logs = []
    for tempo in tempos:
        motion = moved(TorqueModel(load_urdf(urdf), DRIVE), tempo=tempo)
        early = motion.time + 0.5 * (motion.time[1] - motion.time[0]) + late
        dq = np.gradient(motion.position, motion.time, axis=0)
        told = motion.position + (motion.torque + GAINS.kd * dq) / GAINS.kp
        told = np.column_stack([np.interp(early, motion.time, q) for q in told.T])
        logs.append(folder / f"tempo{tempo:g}.csv")
        np.savetxt(
            logs[-1],
            np.column_stack([motion.time, motion.position, np.rad2deg(told)]),
            "%.9g",
            ",",
            header="time,q_shoulder,q_elbow,q_des_shoulder_deg,q_des_elbow_deg",
            comments="",
        )
    return urdf, logs


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return commanded_logs(tmp_path_factory.mktemp("arm"), 1.0, 0.8)


@pytest.mark.slow
def test_gains_make_the_torque_of_every_log(arm):
    urdf, logs = arm
    problem = draft_problem(
        urdf, logs, gains=GAINS, select=False, cutoff=10.0
    ).problem()
    for log, tempo in zip(problem.logs("training"), (1.0, 0.8), strict=True):
        truth = moved(TorqueModel(load_urdf(urdf), DRIVE), tempo=tempo)
        start = np.searchsorted(truth.time, log.time[0])
        expected = truth.torque[start : start + len(log)]
        # Twice interpolated, jumps of friction are rounded off, and nothing else.
        error = np.sqrt(np.mean((log.torque - expected) ** 2))
        assert error < 0.02 * expected.std()


def test_a_log_is_read_as_it_was_written(arm):
    urdf, logs = arm
    found = robot_logs(urdf, logs[0], Statement(gains=GAINS))
    raw = found.read(logs[0])
    assert raw.torque is None
    assert raw.position_command is not None


@pytest.mark.slow
def test_a_model_is_selected_for_the_bodies_of_the_file(arm):
    urdf, logs = arm
    draft = draft_problem(urdf, logs, gains=GAINS, bodies="model")
    table = draft.table(urdf.parent)
    assert draft.selection is not None
    assert all(step.move.kind != "masses" for step in draft.selection.steps)
    assert table.constraints.bodies == "model"
    assert table.data.gains is not None
    assert table.drive.rotor_inertia  # drives that follow commands have gears
    assert len(table.data.recordings) == 4


def test_free_masses_of_known_bodies_are_refused(arm):
    urdf, logs = arm
    with pytest.raises(ProblemError, match="leave one"):
        draft_problem(urdf, logs, gains=GAINS, bodies="model", masses="free")


@pytest.mark.slow
@pytest.mark.parametrize(("late", "drafted"), [(0.0, 0.0), (0.006, 0.006)])
def test_the_delay_of_commands_is_drafted(tmp_path, late, drafted):
    urdf, logs = commanded_logs(tmp_path, 1.0, late=late)
    draft = draft_problem(urdf, logs, gains=GAINS, select=False, cutoff=10.0)
    found = draft.table(tmp_path).data.gains.delay
    assert found == pytest.approx(drafted, abs=1e-3)
    assert draft.problem().delay_of_commands == found
    error = draft.table(tmp_path).data.gains.delay_error
    assert 0.0 < error < 1e-3
    assert draft.problem().drives.calibration.delay_error == error
    assert draft.problem().training[0].torque_shift.any()
    # Also where a problem file asks for both, or for the scale of torque besides.
    problem = draft.problem()
    for scale in (1.0, "estimated"):
        gains = structs.replace(
            problem.table.data.gains, delay="estimated", delay_error=0.0, scale=scale
        )
        data = structs.replace(problem.table.data, gains=gains)
        table = structs.replace(problem.table, data=data)
        asked = problem_of(table, problem.folder / "problem.toml")
        assert 0.0 < asked.drives.calibration.delay_error < 0.01
    wrong = structs.replace(gains, delay_error=1e-3)
    table = structs.replace(table, data=structs.replace(data, gains=wrong))
    with pytest.raises(ProblemError, match=r"delay_error = 0\.001, but delay"):
        problem_of(table, problem.folder / "problem.toml").gains  # noqa: B018


@pytest.mark.slow
def test_a_command_reaches_its_drive_before_the_next_is_sent(tmp_path):
    urdf, logs = commanded_logs(tmp_path, 1.0, late=0.017)
    draft = draft_problem(urdf, logs, gains=GAINS, select=False, cutoff=10.0)
    assert draft.delay == 0.01
    assert 0.01 <= draft.delay_error < 0.02  # by as much the torque fits a longer one
    assert "longest delay that is tried, one sample" in draft.text(tmp_path)


@pytest.mark.slow
def test_friction_of_a_draft_is_nearly_dry_unless_another_is_asked_for(arm):
    urdf, logs = arm
    for asked, drafted in ((None, DRY), (0.2, 0.2)):
        draft = draft_problem(urdf, logs[0], gains=GAINS, friction_velocity=asked)
        assert draft.selection is not None
        assert draft.table(urdf.parent).drive.velocity_scale == drafted
        assert all(s.move.kind != "velocity_scale" for s in draft.selection.steps)


def test_a_log_of_lerobot_is_read_by_its_arrays(arm, tmp_path):
    import pyarrow
    from pyarrow import parquet

    urdf, logs = arm
    raw = robot_logs(urdf, logs[0], Statement(gains=GAINS)).read(logs[0])
    columns = {
        "timestamp": raw.time,
        "frame_index": np.arange(len(raw)),
        "observation.state": list(raw.position),
        "action": list(raw.position_command),
    }
    log = tmp_path / "episode_000000.parquet"
    parquet.write_table(pyarrow.table(columns), log)
    found = robot_logs(urdf, log, Statement(gains=GAINS)).read(log)
    np.testing.assert_allclose(found.position_command, raw.position_command)
    np.testing.assert_allclose(found.position, raw.position)


@pytest.mark.slow
def test_a_torque_at_the_limit_that_is_stated_is_the_drives(arm, capsys):
    urdf, logs = arm
    raw = robot_logs(urdf, logs[0], Statement(gains=GAINS)).read(logs[0])
    most = 0.6 * abs(commanded(raw, GAINS).torque).max(axis=0)
    limited = PDGains(GAINS.kp, GAINS.kd, most)
    clipped = commanded(raw, limited)
    names = raw.joints
    limits = dict(zip(names, most.tolist(), strict=True))
    assert [f.where for f in saturation_findings(clipped)] == list(names)
    assert not saturation_findings(clipped, limits)
    # Where it stays elsewhere, something else holds it.
    other = {name: 1.2 * value for name, value in limits.items()}
    assert len(saturation_findings(clipped, other)) == len(names)
    pairs = zip(GAINS.kp, GAINS.kd, most, strict=True)
    said = [f"{kp},{kd},{limit:.17g}" for kp, kd, limit in pairs]
    main(["check", str(urdf), str(logs[0]), "--gains", *said])
    assert "saturation" not in capsys.readouterr().out
