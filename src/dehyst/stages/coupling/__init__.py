"""The coupling matrix of a stage, and what is more than a matrix."""
