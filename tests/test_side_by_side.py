"""Work of many equal parts: the same to the last bit wherever the run has it done."""

from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from experiments import experiment
from logged import write_arm

from consistent_id import (
    DHRow,
    DriveTerms,
    TorqueModel,
    build_regression,
    draft_problem,
    from_modified_dh,
    simulate_torque,
)
from consistent_id._support.run import Run, running
from consistent_id.cli import main
from consistent_id.comparison import bootstrap
from consistent_id.comparison.consistency_test import consistency_test
from consistent_id.estimation import cross_validated, fit_shapes
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression import segment_regressions
from consistent_id.robot.scaling import reference_bodies

WHERE = [
    "serial",
    *(pytest.param(w, marks=pytest.mark.slow) for w in ("processes:2", "dask:2")),
]


@cache
def _segments():
    model, _, log = experiment(0, joints=2, noise=0.1, samples=800)
    return model, tuple(segment_regressions(model, log, count=8))


def _bootstrap():
    model, segments = _segments()
    return bootstrap(model, segments, replicates=24, seed=3).estimates


def _cross_validation():
    model, segments = _segments()
    path = cross_validated(model, segments, weights=[1e-2, 1.0], folds=3)
    return np.hstack([path.errors, path.parameters])


def _monte_carlo():
    model, _, log = experiment(1, joints=2, noise=2.0, samples=300)
    test = consistency_test(model, build_regression(model, log), draws=60, enough=20)
    return np.array([test.increase, test.p_value, test.draws])


def _model_selection():
    with TemporaryDirectory() as name:
        found = draft_problem(*write_arm(Path(name))).selection
    labels = [step.move.label for step in found.steps]
    return np.array([found.expected, found.plain, found.fits, *map(hash, labels)])


def _starts():
    rng = np.random.default_rng(1)
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.1)])
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05)
    model = TorqueModel(robot, drive)
    joints = tuple(
        tuple(Sinusoid(a, a, f, p) for a, f, p in rng.uniform(0.1, 0.6, (5, 3)))
        for _ in range(2)
    )
    motion = SinusoidalMotion(10.0, 100.0, joints).recording(robot.joint_names)
    x = np.concatenate([reference_bodies(robot).ravel(), rng.uniform(1.0, 3.0, 4)])
    log = simulate_torque(model, x, motion, noise=0.05, rng=rng)
    return np.array(fit_shapes(model, log, starts=3).misfits)


WORK = [
    _bootstrap,
    _cross_validation,
    _monte_carlo,
    pytest.param(_model_selection, marks=pytest.mark.slow),
    _starts,
]


@pytest.mark.slow
@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("work", WORK, ids=lambda work: work.__name__.strip("_"))
def test_results_are_the_same_wherever_the_work_is_done(work, where):
    if where.startswith("dask"):
        pytest.importorskip("distributed")
    here = work()
    with running(Run(executor=where)):
        there = work()
    np.testing.assert_array_equal(there, here)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["", *WHERE])
def test_an_interrupt_keeps_the_replicates_so_far(where, monkeypatch):
    model, segments = _segments()
    whole = bootstrap(model, segments, replicates=24, seed=3)

    @contextmanager
    def impatient(total, what, shown):
        def count(done):
            if done == 12:
                raise KeyboardInterrupt

        yield count

    monkeypatch.setattr(
        "consistent_id.estimation.uncertainties.resampling.counted",
        impatient,
    )
    with running(Run(executor=where)) as run:
        some = bootstrap(model, segments, replicates=24, seed=3)
        assert run.stopped == "interrupted"
    assert some.interrupted and len(some.estimates) == 12
    np.testing.assert_array_equal(some.estimates, whole.estimates[:12])


def test_the_shell_refuses_an_executor_that_there_is_not(capsys):
    for command in ("identify", "compare", "report", "select"):
        with pytest.raises(SystemExit) as ended:
            main([command, "problems/rx60", "--executor", "cloud"])
        assert ended.value.code == 2
        assert "expected serial, processes" in capsys.readouterr().err
