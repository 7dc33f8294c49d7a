"""Diagnostics of an identification: assumptions, residuals, identifiability, and their messages."""
