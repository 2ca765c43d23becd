"""Drafts for robots whose base floats: its motion, and its contacts."""
