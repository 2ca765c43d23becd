"""Drafts for robots whose base floats: how it moves, and what its feet touch."""
