"""dehyst."""
