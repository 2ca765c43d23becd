"""What friction and drives add to a joint's torque: one file for each law."""
