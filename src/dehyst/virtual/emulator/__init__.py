"""Emulated controllers: a virtual bench (`dehyst.virtual.bench`) behind the protocols that laboratories speak."""
