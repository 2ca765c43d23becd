"""Torque of friction and drives at a joint: one file for each law."""
