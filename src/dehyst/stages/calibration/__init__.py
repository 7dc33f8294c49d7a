"""Calibration of all axes of a stage on its rig: the experiment, its path, and its records on disk."""
