"""Uncertainty of estimated parameters: standard errors and intervals."""
