"""Planning of a path: what its start may be, homing, and wave tables."""
