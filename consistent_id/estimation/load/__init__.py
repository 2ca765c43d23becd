"""A robot and the load that it carries."""
