"""Advice on a log whose torque is made of commands."""

import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import draft_problem
from consistent_id.problems.log_check import check_problem
from tests.problems.test_drafts_of_commands import GAINS, commanded_logs


@pytest.mark.slow
@pytest.mark.parametrize("late", some_fast([6, 0]))
def test_late_commands_are_to_be_given_their_delay(tmp_path, late):
    urdf, (log,) = commanded_logs(tmp_path, 1.0)
    head, *_ = log.read_text().splitlines()
    rows = np.loadtxt(log, delimiter=",", skiprows=1, max_rows=1500)
    rows[late:, 3:] = rows[: len(rows) - late, 3:]  # commands, by 60 ms
    np.savetxt(log, rows, "%.9g", ",", header=head, comments="")
    problem = draft_problem(urdf, log, gains=GAINS, select=False, cutoff=10.0).problem()
    lags = check_problem(problem).of("lag")
    assert bool(lags) == bool(late)
    assert all("[data.gains]" in f.advice for f in lags)
