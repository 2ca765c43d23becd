"""A search at its beginning, for a small robot and its log."""

import pytest
from logged import write_arm

from consistent_id import draft_problem
from consistent_id.problems.selection.setup import beginning


@pytest.fixture(scope="package")
def begun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    problem = draft_problem(*write_arm(folder), select=False, cutoff=10.0).problem()
    return beginning(problem, problem.logs("training"), (), 10.0)
