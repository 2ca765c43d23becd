"""Torque as a linear function of the parameters, compressed to triangular factors."""
