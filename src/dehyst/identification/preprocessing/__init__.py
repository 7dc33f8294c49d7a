"""Preprocessing: from a record to cleaned pieces, regressors and internal states."""
