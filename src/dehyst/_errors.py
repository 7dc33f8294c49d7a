"""The exception tree.

::

    DehystError
    ├── RecordError(ValueError)         a measurement that cannot be used
    ├── FileFormatError(ValueError)     a file that cannot be read or written
    │   └── DecimalSignError                numbers that can be read in two ways
    ├── ModelError(ValueError)          an actuator, element or state with impossible numbers
    ├── IdentifyError(ValueError)       a question that the records cannot answer
    ├── MissingExtraError(ImportError)  an optional dependency that is not installed
    └── RigError(OSError)               an instrument that does not do what is needed
        ├── LinkError(ConnectionError)      its connection: refused, lost, silent, garbled
        ├── DeviceError                     an error that the instrument itself reports
        └── SensorError                     a reading that cannot be the displacement

Every error states what was got, what is needed and what to try: as fields, from which its message is made here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from dehyst._text import escaped


class DehystError(Exception):
    """Base class of every exception that dehyst raises on purpose.

    Parameters
    ----------
    message : str, optional
        What is wrong, if `got` and `need` do not state it.
    argument : str, optional
        Name of the argument that is wrong, or several with commas.
    got, need, hint : optional
        What was given, what is needed, and what to try.
    change : sequence of str, optional
        Names of the arguments that the hint is about.
    """

    # The part with the error, such as "axis x: ", before the message.
    part = ""

    def __init__(
        self,
        message: object = "",
        *,
        argument: str = "",
        got: object = "",
        need: str = "",
        hint: str = "",
        change: Sequence[str] = (),
    ) -> None:
        self.message, self.argument, self.got, self.need, self.hint = str(message), argument, str(got), need, hint
        self.change = tuple(change)
        super().__init__(self.text())

    def text(self, named: Callable[[str], str] = str, given: Callable[[str], str] = "{}=".format) -> str:
        """Return the message; `named` returns the shown name of an argument, `given` how to give it, or ""."""
        head = ", ".join(map(named, self.argument.split(", "))) + ": " if self.argument else ""
        got = f"got {self.got}" if self.got else ""
        need = f"need {self.need}" if self.need else ""
        parts = ", ".join(part for part in (self.message, got, need) if part)
        wrong = self.argument.split(", ")
        ways = ", ".join(filter(None, (given(name) for name in self.change if name not in wrong)))
        return f"{self.part}{head}{parts}{'; ' * bool(parts and self.hint)}{self.hint}{f' ({ways})' if ways else ''}"

    def as_dict(self) -> dict[str, object]:
        """Return JSON values."""
        names = ("argument", "got", "need", "hint")
        fields = {name: getattr(self, name) for name in names} | {"change": list(self.change)}
        return {"kind": type(self).__name__, "message": str(self), **fields}

    def __str__(self) -> str:
        """Return the message as one line, with control characters escaped: names in it may come from files."""
        return escaped(super().__str__())


def of_part(error: DehystError, part: str) -> DehystError:
    """Return the error, now with a `part`, such as "axis x", before it."""
    error.part = f"{part}: {error.part}" if part else error.part
    error.args = (error.text(),)
    return error


class RecordError(DehystError, ValueError):
    """A record of voltage and displacement that cannot be used as it is."""


class FileFormatError(DehystError, ValueError):
    """A file that cannot be read: unknown kind, missing column, unknown unit, broken content."""


class DecimalSignError(FileFormatError):
    """A file whose numbers have one meaning with a decimal comma, and another one with a decimal point."""


class ModelError(DehystError, ValueError):
    """Numbers that no actuator can have: a falling spring curve, a negative stiffness, a broken state."""


class IdentifyError(DehystError, ValueError):
    """Records, thresholds or options from which no model can be identified."""


class MissingExtraError(DehystError, ImportError):
    """An optional dependency that is not installed; the message names the extra to install."""

    @classmethod
    def of(cls, package: str, extra: str, purpose: str) -> MissingExtraError:
        """Build the message from the missing `package`, the `extra` that installs it and the `purpose`."""
        return cls(f"{purpose} needs {package}, which is not installed. Try: pip install 'dehyst[{extra}]'")


class RigError(DehystError, OSError):
    """An instrument that does not do what is needed; if possible, its voltage was brought to a safe value."""


class LinkError(RigError, ConnectionError):
    """A failed connection to an instrument or to workers: refused, lost, silent, or with an unreadable answer."""


class DeviceError(RigError):
    """An instrument that reports an error, or does not do what was commanded."""


class SensorError(RigError):
    """A reading that cannot be the displacement: it does not follow the voltage, or saturates."""


class Terminated(SystemExit):
    """A signal that ends the program; a class of its own, because other code may raise SystemExit."""


def library(module: str, purpose: str, extra: str) -> Any:
    """Import a `module` of an optional package; raise MissingExtraError, with the `purpose`, if it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError.of(module.split(".", maxsplit=1)[0], extra, purpose) from error
