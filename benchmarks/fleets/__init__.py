"""A synthetic fleet: its records, and its truth."""
