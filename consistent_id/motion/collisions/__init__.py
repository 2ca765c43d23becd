"""Bodies that must not collide: scenes, distances, clearance proven for all time."""
