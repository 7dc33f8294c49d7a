"""Whether a model is still true of its actuator, by a new record."""
