"""A client of one GCS controller: it sends queries and commands, checks for errors, and resynchronises the link."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst.instruments import gcs_errors, gcs_syntax
from dehyst.instruments.gcs_link import IDENTITY, AbstractGcsLink

_Answer = TypeVar("_Answer")
# Controllers of GCS 2 answer CSV? with 2 at most; older ones do not have the command.
_NEWER = 3.0


class GcsClient:
    """A client of a controller over a link; it sends nothing twice.

    Raise `LinkError` if the answers are not those of a controller. Raise `DeviceError` if its version is not GCS 2.

    Parameters
    ----------
    link : AbstractGcsLink

    Attributes
    ----------
    identity : str
        Its answer to *IDN?.
    commands : frozenset of str
        The commands that it supports.
    """

    def __init__(self, link: AbstractGcsLink) -> None:
        self._link = link
        self.where = link.where
        self._synchronised = True
        self.identity = self._identify()
        self.commands = self.query("HLP?", gcs_syntax.commands)
        if "CSV?" in self.commands:
            version = self.query("CSV?", lambda lines: gcs_syntax.real(gcs_syntax.single(lines)))
            if version >= _NEWER:
                raise DeviceError(f"{self.name}: has GCS {version:g}, need GCS 2; try another firmware")

    @property
    def name(self) -> str:
        """Identity and address."""
        return f"{self.identity} at {self.where}"

    def query(self, line: str, parse: Callable[[list[str]], _Answer], commands: Sequence[str] = ()) -> _Answer:
        """Send commands without answers and a query, and return the answer's lines as parsed by `parse`.

        Raise `LinkError` if there is no answer, or `parse` refuses it; the next call resynchronises first.
        """
        sent = [*commands, line]
        try:
            if not self._synchronised:
                self._settle()
            # Ctrl-C may interrupt the exchange.
            self._synchronised = False
            answer = parse(self._link.exchange(commands, line))
        except RigError as error:
            reason = str(error).removeprefix(f"{self.where}: ")
            raise type(error)(f"{self.where}: sent {gcs_syntax.shown(sent)}, {reason}") from error
        self._synchronised = True
        return answer

    def set(self, *commands: str, expect: frozenset[int] = frozenset()) -> None:
        """Send commands and query the error number.

        Raise `DeviceError` if there is an error that is not in `expect`. Raise `LinkError` if the controller does not
        answer.
        """
        number = self.query("ERR?", _error, commands)
        if number and number not in expect:
            after = f" after {gcs_syntax.shown(commands)}" if commands else ""
            raise DeviceError(f"{self.name}: {gcs_errors.sentence(number)}{after}")

    def clear(self) -> None:
        """Clear a latched error, and resynchronise."""
        self.query("ERR?", _error)

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _settle(self) -> None:
        self._link.settle(self.identity)
        # The error of a failed exchange would be taken for that of the next one.
        self._link.exchange([], "ERR?")

    def _identify(self) -> str:
        try:
            lines = self._link.exchange([], IDENTITY)
        except LinkError as error:
            raise LinkError(
                f"{self.where}: sent '{IDENTITY}', {error}; is it a GCS controller, and no other client connected? "
                "It takes one at a time"
            ) from error
        text = " ".join(lines).strip()
        if lines[0].startswith(("HTTP/", "<")):
            raise LinkError(f"{self.where}: a web server answers ({gcs_syntax.shown(text)}); PI's port is 50000")
        if text.count(",") < 2 or len(lines) > 1:
            raise LinkError(
                f"{self.where}: sent '{IDENTITY}', got {gcs_syntax.shown(text)}, need maker, model, serial number; "
                "is it a GCS controller?"
            )
        return text


def _error(lines: Sequence[str]) -> int:
    return gcs_syntax.integer(gcs_syntax.single(lines))
