"""The exception tree.

::

    DehystError
    ├── RecordError(ValueError)         a measurement that cannot be used
    ├── FileFormatError(ValueError)     a file that cannot be read or written
    ├── ModelError(ValueError)          an actuator, element or state with impossible numbers
    ├── IdentifyError(ValueError)       a question that the records cannot answer
    └── MissingExtraError(ImportError)  an optional dependency that is not installed

Every message says what was got, what is needed and what to try.
"""

from __future__ import annotations


class DehystError(Exception):
    """Root of every exception that dehyst raises on purpose."""


class RecordError(DehystError, ValueError):
    """A record of voltage and displacement that cannot be used as it is."""


class FileFormatError(DehystError, ValueError):
    """A file that cannot be read: unknown kind, missing column, unknown unit, broken content."""


class ModelError(DehystError, ValueError):
    """Numbers that no actuator can have: a falling spring curve, a negative stiffness, a broken state."""


class IdentifyError(DehystError, ValueError):
    """Records, thresholds or options from which no model can be identified."""


class MissingExtraError(DehystError, ImportError):
    """An optional dependency is needed and not installed; the message says which extra to install."""

    @classmethod
    def of(cls, package: str, extra: str, purpose: str) -> MissingExtraError:
        """Build the message from the missing `package`, the `extra` that brings it and the `purpose`."""
        return cls(f"{purpose} needs {package}, which is not installed. Try: pip install 'dehyst[{extra}]'")
