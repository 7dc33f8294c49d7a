"""Coupling of several axes: the matrix, the axes beside it, and what no matrix describes."""
