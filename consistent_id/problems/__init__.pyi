from consistent_id.problems.draft import Draft
from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.loading import load_problem, load_problems
from consistent_id.problems.opening import identify_log
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import identify
from consistent_id.problems.selection.model_selection import (
    ModelSelection,
    select_model,
)
from consistent_id.problems.statement import Statement
from consistent_id.problems.study import Study, run_study

__all__ = [
    "Draft",
    "ModelSelection",
    "Problem",
    "Statement",
    "Study",
    "draft_problem",
    "identify",
    "identify_log",
    "load_problem",
    "load_problems",
    "run_study",
    "select_model",
]
