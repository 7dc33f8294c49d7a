"""The workbench: the whole journey in a browser, on this machine."""

from dehyst.workbench.serving import serve

__all__ = ["serve"]
