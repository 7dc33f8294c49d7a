"""Regression: from rows to coefficients, and from coefficients to an actuator."""
