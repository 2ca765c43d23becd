"""Rows that are no single joint's torque: of a base, of contacts, of wrench sensors."""
