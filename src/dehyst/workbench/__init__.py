"""The workbench: all steps from a record to an export, in a browser on this machine."""

from dehyst.workbench.serving import serve
