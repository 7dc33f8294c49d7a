"""One of each kind of plug-in for dehyst; none of these names is imported before it is used."""
