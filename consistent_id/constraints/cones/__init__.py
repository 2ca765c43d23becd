"""Convex sets, cone programmes, and proofs of optimality and infeasibility."""
