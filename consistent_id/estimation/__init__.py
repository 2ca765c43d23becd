"""Estimators: from a regression to an estimate."""
