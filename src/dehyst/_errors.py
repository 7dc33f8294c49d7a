"""The exception tree.

::

    DehystError
    ├── RecordError(ValueError)         a measurement that cannot be used
    ├── FileFormatError(ValueError)     a file that cannot be read or written
    ├── ModelError(ValueError)          an actuator, element or state with impossible numbers
    ├── IdentifyError(ValueError)       a question that the records cannot answer
    ├── MissingExtraError(ImportError)  an optional dependency that is not installed
    └── RigError(OSError)               an instrument that does not do what is needed
        ├── LinkError(ConnectionError)      its connection: refused, lost, silent, garbled
        ├── DeviceError                     it says itself that something is wrong
        └── SensorError                     its reading tells nothing of the displacement

Every message says what was got, what is needed and what to try.
"""

from __future__ import annotations

from dehyst._text import escaped


class DehystError(Exception):
    """Root of every exception that dehyst raises on purpose."""

    def __str__(self) -> str:
        """Return the message as one line; names in it may hold what a terminal would obey."""
        return escaped(super().__str__())


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


class RigError(DehystError, OSError):
    """An instrument that does not do what is needed; its voltage was brought to a safe value if it could be."""


class LinkError(RigError, ConnectionError):
    """The connection to an instrument: refused, lost, silent, or what comes is no answer."""


class DeviceError(RigError):
    """An instrument reports an error, or does something else than it was told."""


class SensorError(RigError):
    """The displacement that an instrument reads cannot be one: it does not move, or no further, with the voltage."""
