"""Exciting motion of a robot that stands: its trunk sways, its feet stay."""
