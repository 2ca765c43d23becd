"""A published study, reproduced: experiments, tables, explanations, verification."""

from consistent_id.laboratory.reproduction.budget import ErrorBudget, error_budget
from consistent_id.laboratory.reproduction.experiments import (
    IdentifiedExperiment,
    ParameterTable,
    Reproduction,
    identify_experiment,
    perform_experiments,
    reproduce_experiments,
)
from consistent_id.laboratory.reproduction.paper_study import (
    FULL,
    QUICK,
    Extent,
    PaperStudy,
    reproduce,
)

__all__ = [
    "FULL",
    "QUICK",
    "ErrorBudget",
    "Extent",
    "IdentifiedExperiment",
    "PaperStudy",
    "ParameterTable",
    "Reproduction",
    "error_budget",
    "identify_experiment",
    "perform_experiments",
    "reproduce",
    "reproduce_experiments",
]
