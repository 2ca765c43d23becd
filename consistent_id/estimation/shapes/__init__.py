"""Parameters of friction in which the torque is not linear."""
