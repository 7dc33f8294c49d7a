"""A client of one GCS controller: asks and is answered, sets and looks for an error, and gets back into step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst.instruments import gcs_errors, gcs_syntax
from dehyst.instruments.gcs_link import IDENTITY, AbstractGcsLink

_Found = TypeVar("_Found")
# Who speaks GCS 2 answers up to 2; older devices do not know the question.
_NEWER = 3.0


class GcsClient:
    """Speaks to a controller over a link; nothing is ever sent twice.

    Parameters
    ----------
    link : AbstractGcsLink

    Attributes
    ----------
    identity : str
        What it answers to *IDN?.
    commands : frozenset of str
        What it knows.

    Raises
    ------
    LinkError
        If it does not answer as a controller does.
    DeviceError
        If it speaks another version than GCS 2.
    """

    def __init__(self, link: AbstractGcsLink) -> None:
        self._link = link
        self.where = link.where
        self._in_step = True
        self.identity = self._introduced()
        self.commands = self.ask("HLP?", gcs_syntax.commands)
        if "CSV?" in self.commands:
            version = self.ask("CSV?", lambda lines: gcs_syntax.real(gcs_syntax.single(lines)))
            if version >= _NEWER:
                raise DeviceError(f"{self.name}: speaks GCS {version:g}, need GCS 2; try another firmware")

    @property
    def name(self) -> str:
        """Identity and address."""
        return f"{self.identity} at {self.where}"

    def ask(self, query: str, parse: Callable[[list[str]], _Found], commands: Sequence[str] = ()) -> _Found:
        """Send commands that are not answered and a query, and return what `parse` makes of the answer's lines.

        Raises
        ------
        LinkError
            If there is no answer, or `parse` finds that it is none; the next call gets into step first.
        """
        sent = [*commands, query]
        try:
            if not self._in_step:
                self._settle()
            # Ctrl-C may come in the middle.
            self._in_step = False
            found = parse(self._link.exchange(commands, query))
        except RigError as error:
            said = str(error).removeprefix(f"{self.where}: ")
            raise type(error)(f"{self.where}: sent {gcs_syntax.shown(sent)}, {said}") from error
        self._in_step = True
        return found

    def set(self, *commands: str, expect: frozenset[int] = frozenset()) -> None:
        """Send commands and ask for the error that they raise.

        Raises
        ------
        DeviceError
            If there is one, but those to `expect`.
        LinkError
            If the controller does not answer.
        """
        number = self.ask("ERR?", _error, commands)
        if number and number not in expect:
            after = f" after {gcs_syntax.shown(commands)}" if commands else ""
            raise DeviceError(f"{self.name}: {gcs_errors.sentence(number)}{after}")

    def clear(self) -> None:
        """Forget a latched error, and get into step."""
        self.ask("ERR?", _error)

    def close(self) -> None:
        """Let the link go."""
        self._link.close()

    def _settle(self) -> None:
        self._link.settle(self.identity)
        # What an exchange that went wrong has left behind would be taken for the next one's.
        self._link.exchange([], "ERR?")

    def _introduced(self) -> str:
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
