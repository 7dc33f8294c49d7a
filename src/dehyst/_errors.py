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
        ├── DeviceError                     an error that the instrument itself reports
        └── SensorError                     a reading that cannot be the displacement

Every message states what was got, what is needed and what to try.
"""

from __future__ import annotations

from dehyst._text import escaped


class DehystError(Exception):
    """Base class of every exception that dehyst raises on purpose."""

    def __str__(self) -> str:
        """Return the message as one line, with control characters escaped: names in it may come from files."""
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
    """An optional dependency that is not installed; the message names the extra to install."""

    @classmethod
    def of(cls, package: str, extra: str, purpose: str) -> MissingExtraError:
        """Build the message from the missing `package`, the `extra` that brings it and the `purpose`."""
        return cls(f"{purpose} needs {package}, which is not installed. Try: pip install 'dehyst[{extra}]'")


class RigError(DehystError, OSError):
    """An instrument that does not do what is needed; its voltage was brought to a safe value if it could be."""


class LinkError(RigError, ConnectionError):
    """A failed connection to an instrument or to workers: refused, lost, silent, or with an unreadable answer."""


class DeviceError(RigError):
    """An instrument that reports an error, or does not do what was commanded."""


class SensorError(RigError):
    """A reading that cannot be the displacement: it does not follow the voltage, or saturates."""
