"""Estimators: from a regression, constraints and a prior to an estimate."""
