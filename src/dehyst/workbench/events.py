"""News for all open pages: the state when it changed, and live samples."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

# Seconds between two states, so that many changes at once are one message.
_PAUSE = 0.05
# Messages that a slow page may be behind; then live samples are left out.
_BEHIND = 50


class Events:
    """The news of one workbench.

    Parameters
    ----------
    state : callable
        Returns the state, as JSON values.
    """

    def __init__(self, state: Callable[[], Mapping[str, Any]]) -> None:
        self._state = state
        self._pages: set[_Page] = set()
        self._text = ""
        self._pending: asyncio.Task[None] | None = None

    def changed(self) -> None:
        """Send the state soon; many changes at once are sent once."""
        self._text = ""
        if self._pages and (self._pending is None or self._pending.done()):
            self._pending = asyncio.get_running_loop().create_task(self._publish())

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message that may be left out, such as live samples."""
        text = json.dumps(message, allow_nan=False)
        for page in self._pages:
            if page.news.qsize() < _BEHIND:
                page.news.put_nowait(text)

    async def page(self) -> AsyncIterator[str]:
        """Yield the messages for one page: first the state. A slow page receives the newest state only."""
        page = _Page()
        page.change()
        self._pages.add(page)
        try:
            while True:
                text = await page.news.get()
                if text is None:
                    page.behind = False
                    text = self._now()
                yield text
        finally:
            self._pages.discard(page)

    def _now(self) -> str:
        """Return the state as a message, made once for all pages."""
        self._text = self._text or json.dumps({"kind": "state", "state": self._state()}, allow_nan=False)
        return self._text

    async def _publish(self) -> None:
        await asyncio.sleep(_PAUSE)
        for page in self._pages:
            page.change()


class _Page:
    """One open page: its messages in their order, None where the state is to be sent."""

    def __init__(self) -> None:
        self.news: asyncio.Queue[str | None] = asyncio.Queue()
        self.behind = False

    def change(self) -> None:
        """Note that the state is to be sent, once."""
        if not self.behind:
            self.behind = True
            self.news.put_nowait(None)
