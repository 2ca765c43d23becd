"""A robot: its tree of links, their inertial parameters, the files that hold it."""
