"""Exciting trajectories: motions from which parameters can be told, within limits."""
