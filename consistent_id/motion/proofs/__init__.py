"""Proofs that a path keeps its limits of motion and torque at all times."""
