"""The version of sources that are not built: a build puts git's version in the place of this file."""

__version__ = "0.1.0.dev0"
