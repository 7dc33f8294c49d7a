"""Emulated controllers: a virtual bench (`dehyst.instrument`) behind the protocols that laboratories speak."""
