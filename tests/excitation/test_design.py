"""Designs: proven, repeatable, as accurate as they say, and refused with a reason."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excited import FRICTION, arm, arm_limits
from some_fast import some_fast

from consistent_id import (
    InfeasibleError,
    NotExcitedError,
    ProblemError,
    TorqueModel,
    build_regression,
    simulate_torque,
)
from consistent_id.excitation.accuracy import path_regressor, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.stages import DesignSearch, _allowed_peaks
from consistent_id.excitation.verification import Demands, PathProof
from consistent_id.motion.proofs.margins import Margin, MotionMargins, motion_margins
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.regression import base_parameters

FORM = PathForm(5.0, 3)
PLENTY = 600.0  # seconds that no test takes


def designed(robot=None, aim=None, *, form=FORM, **how):
    robot = arm(2) if robot is None else robot
    of = robot.robot if isinstance(robot, TorqueModel) else robot
    given = dict(
        limits=arm_limits(of), starts=1, workers=1, time_limit=PLENTY, seed=0
    ) | how  # fmt: skip
    return design_trajectory(robot, form, aim, **given)


def information(path, robot=None, aim=None):
    """``M`` of a path at all samples that will be recorded."""
    model = TorqueModel(arm(2)) if robot is None else robot
    base = base_parameters(model)
    factor = predicted_accuracy(model, base, path, aim).factor
    return factor.T @ factor


def size_of_errors(path, aim):
    """A: root sum of squares of the standard errors."""
    model = TorqueModel(arm(2))
    accuracy = predicted_accuracy(model, base_parameters(model), path, aim)
    return np.linalg.norm(accuracy.standard_errors())


@pytest.mark.slow
def test_a_design_is_proven_and_better_than_random():
    design = designed(arm(3), Aim("condition"))
    assert [stage.objective for stage in design.stages] == ["condition", "D"]
    first, second = design.stages
    assert first.accuracy.condition.value < 0.5 * design.unoptimised.condition.value
    assert first.value == pytest.approx(first.accuracy.condition.value, rel=0.02)
    assert design.trajectory is second.trajectory
    assert design.condition is second.accuracy.condition
    margins = motion_margins(design.trajectory, design.limits)
    assert margins.holds and design.proof.holds
    design.proof.require()
    assert design.notes == (
        "collisions are not checked: no scene",
        "torque has no limit",
    )


@pytest.mark.slow
def test_the_second_stage_has_smaller_errors_within_the_bound():
    first, second = designed(arm(3), Aim("condition", growth=1.2)).stages
    model = TorqueModel(arm(3))
    matrices = [information(stage.trajectory, model) for stage in (first, second)]
    determinants = [np.linalg.slogdet(matrix).logabsdet for matrix in matrices]
    assert determinants[1] > determinants[0] + 1.0
    # Searches take fewer samples than will be recorded, hence the last two percent.
    conditions = [np.sqrt(np.linalg.cond(matrix)) for matrix in matrices]
    assert conditions[1] <= 1.2 * 1.02 * conditions[0]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_design_however_many_workers():
    first, again, many = (
        designed(workers=workers, starts=3, seed=3) for workers in (1, 1, 2)
    )
    for design in (again, many):
        assert [s.number for s in design.stages] == [s.number for s in first.stages]
        for field in ("offset", "sine", "cosine"):
            mine, theirs = (getattr(d.trajectory, field) for d in (first, design))
            assert np.array_equal(mine, theirs)
        assert not any("another run may differ" in note for note in design.notes)


@pytest.mark.slow
def test_torque_limits_bind_and_are_proven():
    robot = arm(2)
    free = designed(aim=Aim(refine=None))
    motion = free.trajectory.evaluate(np.linspace(0.0, 5.0, 2001))
    reached = abs(TorqueModel(robot).predict(robot.nominal, *motion)).max(axis=0)
    effort = dict(zip(robot.joint_names, 0.8 * reached, strict=True))
    members = np.array([robot.nominal, 1.05 * robot.nominal])
    design = designed(
        aim=Aim(refine=None),
        limits=arm_limits(robot, effort=effort),
        parameters=members,
    )
    torque = [m for m in design.proof.margins.margins if m.quantity == "torque"]
    assert all(m.holds for m in torque)
    assert min(m.relative for m in torque) < 0.08
    motion = design.trajectory.evaluate(np.linspace(0.0, 5.0, 2001))
    for member in members:
        worst = abs(TorqueModel(robot).predict(member, *motion)).max(axis=0)
        assert (worst <= 0.8 * reached).all()


@pytest.mark.slow
def test_the_worst_of_a_set_is_kept_where_one_robot_alone_would_not_be():
    robot = arm(2)
    light = designed(aim=Aim(refine=None))
    motion = light.trajectory.evaluate(np.linspace(0.0, 5.0, 2001))
    reached = abs(TorqueModel(robot).predict(robot.nominal, *motion)).max(axis=0)
    limits = arm_limits(robot, effort=1.05 * reached)
    heavy = np.array([robot.nominal, 1.4 * robot.nominal])
    alone = motion_margins(
        light.trajectory, limits, model=TorqueModel(robot), parameters=heavy
    )
    assert not alone.holds
    assert designed(aim=Aim(refine=None), limits=limits, parameters=heavy).proof.holds


@pytest.mark.slow
def test_paths_that_never_repeat_are_proven_too():
    form = PathForm(6.0, 3, base_frequencies=(0.1, 0.1 * 2**0.5))
    design = designed(form=form, aim=Aim(refine=None))
    assert design.trajectory.period is None
    assert design.proof.holds


# Predicted accuracy -----------------------------------------------------------------


@pytest.mark.slow
def test_predicted_errors_are_those_of_simulated_least_squares():
    model, rng = TorqueModel(arm(2), FRICTION), np.random.default_rng(0)
    base = base_parameters(model)
    noise = np.array([0.3, 1.5])
    aim = Aim(noise=noise, rate=40.0, correlation_time=0.0)
    path = designed(TorqueModel(arm(2)), Aim(refine=None)).trajectory
    W = path_regressor(model, base, path, 40.0) / noise[:, None, None]
    W = W.reshape(-1, len(base))
    trials = 2000
    errors = np.linalg.pinv(W) @ rng.normal(size=(len(W), trials))
    predicted = predicted_accuracy(model, base, path, aim).standard_errors()
    # The standard deviation of 2000 trials is known to 1/sqrt(2 x 2000) = 1.6 %.
    assert np.allclose(errors.std(axis=1), predicted, rtol=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("repetitions", some_fast([12.5, 3.0, 1.0]))
def test_repetitions_add_their_information_to_what_is_known(repetitions):
    model = TorqueModel(arm(2))
    base, rng = base_parameters(model), np.random.default_rng(0)
    motion = designed(aim=Aim(refine=None)).trajectory.recording(20.0)
    known = build_regression(
        model, simulate_torque(model, arm(2).nominal, motion, noise=0.1, rng=rng)
    )
    noise = np.array([0.5, 2.0])
    path = FourierTrajectory(
        arm(2).joint_names, [0.2, 0.4], [0, 0], [[0.2, 0.3], [0.2, 0.1]],
        [[0, 0.1], [0.1, 0]], 5.0,
    )  # fmt: skip
    accuracy = predicted_accuracy(model, base, path, Aim(noise=noise, earlier=known))
    rows = []
    for time, q, dq, ddq in (
        (path.start + np.arange(501) / 100.0, None, None, None),
        (motion.time, motion.position, motion.velocity, motion.acceleration),
    ):
        q, dq, ddq = path.evaluate(time) if q is None else (q, dq, ddq)
        Y = model.regressor(q, dq, ddq)[:, list(base.independent)]
        rows.append(
            (Y / noise[:, None, None]).transpose(0, 2, 1).reshape(-1, len(base))
        )
    M = repetitions * rows[0].T @ rows[0] + rows[1].T @ rows[1]
    expected = np.sqrt(np.diag(np.linalg.inv(M)))
    assert np.allclose(accuracy.standard_errors(repetitions), expected, rtol=1e-6)


@pytest.mark.slow
def test_repetitions_for_a_wanted_error_reach_it_and_no_fewer_do():
    design = designed(aim=Aim(refine=None, noise=0.5))
    name = design.base.names[1]
    now = design.accuracy.standard_errors()[1]
    # Without earlier recordings errors fall with the root of the number.
    assert design.accuracy.repetitions_for({name: now / 3.0}) == pytest.approx(9.0)
    with pytest.raises(ProblemError, match="leads no base parameter"):
        design.accuracy.repetitions_for({"nothing": 1.0})
    with pytest.raises(ProblemError, match="expected positive"):
        design.accuracy.repetitions_for({name: 0.0})


@pytest.mark.slow
def test_the_table_says_what_errors_are_of():
    design = designed(aim=Aim(refine=None))
    text = design.accuracy.table().text()
    assert "per N m of noise" in text and "column scaling: none" in text


@pytest.mark.slow
@pytest.mark.parametrize("noise", [(0.1, 1.0, 5.0), (5.0, 1.0, 0.1)])
def test_a_design_for_a_noise_is_the_better_one_under_it(noise):
    model = TorqueModel(arm(3))
    base = base_parameters(model)
    aim, equal = (Aim("condition", refine=None, noise=n) for n in (noise, None))
    # The better of two searches: where one ends depends on the machine's rounding.
    for_it, for_equal = (designed(arm(3), a, starts=2).trajectory for a in (aim, equal))

    def condition(path, under):
        return predicted_accuracy(model, base, path, under).condition.value

    assert condition(for_it, aim) < 0.9 * condition(for_equal, aim)
    assert condition(for_equal, equal) < 0.9 * condition(for_it, equal)


@pytest.mark.slow
def test_a_design_takes_account_of_earlier_recordings():
    model, rng = TorqueModel(arm(2)), np.random.default_rng(0)
    # One joint has moved, for long: what it identifies needs no more motion.
    sine, cosine = [[0.6, 0.0], [0.3, 0.0]], [[0.15, 0.0], [0.3, 0.0]]
    first = FourierTrajectory(
        arm(2).joint_names, [0.2, 0.4], [0, 0], sine, cosine, duration=5.0
    )
    known = build_regression(
        model,
        simulate_torque(
            model, arm(2).nominal, first.recording(2000.0), noise=0.1, rng=rng
        ),
    )
    aim = Aim(objective="A", refine=None, earlier=known)
    next_one = designed(aim=aim, starts=2).trajectory
    blind = designed(aim=Aim(objective="A", refine=None), starts=2).trajectory
    base = base_parameters(model)
    assert size_of_errors(next_one, aim) < 0.95 * size_of_errors(blind, aim)
    alone = predicted_accuracy(model, base, next_one, Aim()).standard_errors()
    together = predicted_accuracy(model, base, next_one, aim).standard_errors()
    assert (together < alone).all()


# Refusals ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effort", "why"),
    [
        (0.5, r"joint2 needs 0\.797 .* may use 0\.35"),  # in its best pose, 0.797 N m
        (
            1.15,
            "torque of joint 'joint2'",
        ),  # 0.805 N m: there is hardly a pose
    ],
)
def test_an_effort_that_cannot_be_kept_names_the_joint(effort, why):
    limits = arm_limits(arm(2), effort={"joint2": effort})
    with pytest.raises(InfeasibleError, match=why):
        designed(limits=limits)


def test_a_path_too_short_to_move_names_the_joint():
    limits = arm_limits(arm(2), velocity={"joint1": 2.0, "joint2": 1e-3})
    with pytest.raises(ProblemError, match=r"in 5 s joint 'joint2' can move 0\.0025"):
        designed(limits=limits)
    with pytest.raises(ProblemError, match="make the path longer"):
        designed(form=PathForm(0.05, 3), aim=Aim(rate=1000.0))


def test_a_joint_without_range_is_named():
    with pytest.raises(ProblemError, match=r"'joint2'.*not below"):
        arm_limits(arm(2), position={"joint1": (-1.0, 1.0), "joint2": (0.3, 0.3)})


def test_frequencies_that_cannot_be_seen_are_refused():
    with pytest.raises(ProblemError, match="cannot be recorded at 1 Hz"):
        designed(aim=Aim(rate=1.0))


@pytest.mark.slow
def test_motion_that_cannot_tell_parameters_apart_is_refused():
    # No joint moves by more than a hundred-millionth of its range.
    ranges = {name: (0.0, 1e-8) for name in arm(2).joint_names}
    with pytest.raises(NotExcitedError, match="identifies all base parameters"):
        designed(limits=arm_limits(arm(2), position=ranges))


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ((1.0, 2.0, 3.0), "noise"),
        ((1.0, 0.0), "expected positive"),
        ({"joint1": 1.0}, "noise of joint2 is missing"),
        ({"joint1": 1.0, "joint2": 1.0, "jiont": 1.0}, "no such joint"),
    ],
)
def test_noise_that_does_not_fit_is_refused(noise, said):
    with pytest.raises(ProblemError, match=said):
        designed(aim=Aim(noise=noise))


def test_parameters_of_another_model_are_refused():
    with pytest.raises(ProblemError, match=r"shape \(3,\)"):
        designed(parameters=[1.0, 2.0, 3.0])


# Interrupts -------------------------------------------------------------------------

INTERRUPTED = """
import glob, json, os, signal, sys, tempfile, threading, time
from excited import arm, arm_limits
from consistent_id._support.run import Run, signals_raised
from consistent_id.excitation.aims import PathForm
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.verification import Demands

def interrupt():
    while not glob.glob(tempfile.gettempdir() + "/excitation-*/*.npz"):
        time.sleep(0.01)
    if sys.argv[2] == "SIGINT":
        os.killpg(0, signal.SIGINT)  # as a terminal does
    else:
        os.kill(os.getpid(), signal.SIGTERM)  # as `kill` does

threading.Thread(target=interrupt, daemon=True).start()
with signals_raised(Run()):
    design = design_trajectory(
        arm(3), PathForm(5.0, 3), limits=arm_limits(arm(3)),
        starts=10_000, time_limit=3600.0, workers=int(sys.argv[1]),
    )
print(json.dumps([design.notes, design.proof.holds, len(design.stages)]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "number"), [(1, "SIGINT"), (2, "SIGINT"), (2, "SIGTERM")]
)
def test_an_interrupt_keeps_the_best(workers, number, tmp_path):
    tests = Path(__file__).parents[1] / "helpers"
    environment = os.environ | {
        "TMPDIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tests), str(tests.parent)]),
    }
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(workers), number],
        capture_output=True,
        text=True,
        timeout=120,
        env=environment,
        start_new_session=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    notes, holds, stages = json.loads(ended.stdout)
    assert any("ended the search" in note for note in notes)
    assert holds and stages == 1
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
def test_a_motor_without_a_torque_sensor_has_a_limit_all_the_same():
    robot = arm(2)
    model = TorqueModel(robot, torque_joints=("joint2",))
    aim = Aim(refine=None)
    free = designed(model, aim)
    motion = free.trajectory.evaluate(np.linspace(0.0, 5.0, 2001))
    reached = abs(TorqueModel(robot).predict(robot.nominal, *motion)).max(axis=0)
    limits = arm_limits(robot, effort={"joint1": 0.8 * reached[0]})
    margins = motion_margins(
        free.trajectory, limits, model=model, parameters=robot.nominal
    )
    assert not margins.holds and margins.least.joint == "joint1"
    bound = designed(model, aim, limits=limits)
    assert bound.proof.holds
    of_torque = [m for m in bound.proof.margins.margins if m.quantity == "torque"]
    assert [m.joint for m in of_torque] == ["joint1"]


@pytest.mark.slow
def test_a_path_that_cannot_be_proven_never_leaves(monkeypatch):
    true_proof = Demands.proof

    def refusing(self, paths):
        return true_proof(replace(self, limits=self.limits.within(0.05)), paths)

    monkeypatch.setattr(Demands, "proof", refusing)
    with pytest.raises(InfeasibleError, match="is not kept"):
        designed(arm(2), Aim(refine=None), time_limit=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "most"), [(False, 1.3), (True, 2.0)])
def test_a_path_that_is_not_proven_costs_little_more_work(monkeypatch, lost, most):
    """Two proofs fail; a search that then finds nothing in little work gets more."""
    robot = arm(2)
    limits = arm_limits(robot, effort=0.6 * np.array([9.0, 3.0]))
    proofs, true_proof, searches, true_run = [], Demands.proof, [], DesignSearch._run

    def failing(self, path):
        proofs.append(true_proof(self, path))
        failed = replace(self, limits=self.limits.within(0.05))
        return true_proof(failed, path) if len(proofs) <= 2 else proofs[-1]

    def run(self, problem, starts, work):
        searches.append(self)
        found = true_run(self, problem, starts, work)
        return () if lost and len(searches) in (2, 4) else found

    monkeypatch.setattr(Demands, "proof", failing)
    monkeypatch.setattr(DesignSearch, "_run", run)
    design = designed(robot, Aim(refine=None), limits=limits, time_limit=1.0, workers=1)
    assert design.proof.holds and len(proofs) == 3
    assert len(searches) == (5 if lost else 3)
    meter = searches[0].meter
    assert meter.spent < most * meter.allowed


def test_a_torque_that_is_too_much_over_time_lowers_its_peak_in_proportion():
    def peaks(*margins):
        known = [
            Margin(f"joint{joint}", quantity, limit, bound, bound, 0.0, limit)
            for joint, quantity, limit, bound in margins
        ]
        return _allowed_peaks(PathProof(MotionMargins(tuple(known)), None))

    # A motion whose torque is scaled so that its extremes fall from bound to limit.
    peak, rms, rate = (1, "torque", 20.0, 12.0), "torque RMS", "torque rate"
    assert peaks(peak, (1, rms, 3.0, 4.0)) == {"joint1": pytest.approx(9.0)}
    # Of two limits that are violated, the one that needs less torque counts.
    both = (1, rms, 3.0, 4.0), (1, rate, 50.0, 100.0)
    assert peaks(peak, *both) == {"joint1": pytest.approx(6.0)}
    assert peaks(peak, *both[::-1]) == {"joint1": pytest.approx(6.0)}
    # A peak without a limit is guessed: twice the root mean square that is allowed.
    assert peaks(peak, (2, rms, 3.0, 4.0)) == {"joint2": pytest.approx(4.5)}
    kept = [(1, rms, 3.0, 3.0), (1, rate, 50.0, 49.0), (1, "torque", 20.0, 21.0)]
    assert peaks(*kept, (1, "velocity", 1.0, 2.0)) == {}


@pytest.mark.slow
def test_a_design_is_drawn_as_shares_of_its_limits():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    pyplot.close("all")
    design = designed(starts=1, time_limit=2.0)
    limits, joints = design.limits, len(design.limits.joints)
    figure, given = pyplot.subplots(joints, 3)
    axes = design.plot(given)
    assert axes.shape == (joints, 3)
    assert [a.get_ylabel() for a in axes[:, 0]] == list(limits.joints)
    ends = design.trajectory.start + np.array([0.0, design.trajectory.duration])
    for j in range(joints):
        for column, axis in enumerate(axes[j]):
            line = axis.get_lines()[0]
            assert line.get_xdata()[[0, -1]] == pytest.approx(ends)
            of_joint = design.trajectory.evaluate(line.get_xdata())[column, :, j]
            limit, middle = limits.derivative(column)[j], 0.0
            if column == 0:
                middle = (limits.lower[j] + limits.upper[j]) / 2
            limit = limit if np.isfinite(limit) else 1.0
            np.testing.assert_allclose(line.get_ydata(), (of_joint - middle) / limit)
    assert pyplot.get_fignums() == [figure.number]
    with pytest.raises(ProblemError, match="1 axes for the motion of 2 joints"):
        design.plot(given[0, 0])
    pyplot.close("all")
