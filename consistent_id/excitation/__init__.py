"""Exciting trajectories: motions within limits that identify the parameters."""
