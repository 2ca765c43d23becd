"""A paper's study done again: experiments, tables, explanations, verification."""

from consistent_id.reproduction.experiments import (
    IdentifiedExperiment,
    ParameterTable,
    Reproduction,
    identify_experiment,
    perform_experiments,
    reproduce_experiments,
)

__all__ = [
    "IdentifiedExperiment",
    "ParameterTable",
    "Reproduction",
    "identify_experiment",
    "perform_experiments",
    "reproduce_experiments",
]
