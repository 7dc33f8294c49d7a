"""Planning of a path: its possible starts, homing, and wave tables."""
