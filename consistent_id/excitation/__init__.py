"""Exciting trajectories: motions that make parameters identifiable, within limits."""
