"""What a robot is: its tree of links, their inertial parameters, files that hold it."""
