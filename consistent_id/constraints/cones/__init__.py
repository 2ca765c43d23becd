"""Convex sets, programmes over them, and proofs of optimality and emptiness."""
