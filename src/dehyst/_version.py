"""The version of the package: the one that the package's metadata give."""

__version__ = "0.1.0"
