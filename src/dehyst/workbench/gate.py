"""Access control of the server."""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from hmac import compare_digest
from http.cookies import CookieError, SimpleCookie
from typing import Any, TypeAlias
from urllib.parse import parse_qs

Scope: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send: TypeAlias = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App: TypeAlias = Callable[[Scope, Receive, Send], Awaitable[None]]

_READING = ("GET", "HEAD")
_METHODS = (*_READING, "POST", "PUT", "DELETE")
# What a browser says of a request that its own page or its user made.
_OWN_SITES = ("same-origin", "none")
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self'; img-src 'self' data:; "
        "style-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'; object-src 'none'"
    ),
}
_REFUSED = 1008
_NO_COOKIE = "the cookie of this workbench is missing"
_USED = (
    "Refused: this link was used already, or is older than a minute. Press Enter in the terminal of dehyst workbench: "
    "it prints a new one."
)
# The page that a link leads to: a browser sends the cookie with what this page requests, but perhaps not with what
# another site or a file led to. It names an empty icon, as the workbench has none at /favicon.ico.
_ENTRANCE = (
    '<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=/"><title>dehyst workbench</title>'
    '<link rel="icon" href="data:,"><a href="/">Open the workbench</a>'
)
# Stands for a header that comes twice.
_TWICE = ""


class Gate:
    """An ASGI application that protects another one.

    Parameters
    ----------
    app : callable
        The protected application.
    port : int
        At which the server listens.
    admits : callable
        Takes the token of a link, ``/?token=...``; returns whether it lets a browser in.
    """

    def __init__(self, app: App, port: int, admits: Callable[[str], bool]) -> None:
        self._app, self._key = app, secrets.token_urlsafe(32)
        self._admits = admits
        self._cookie = f"dehyst-{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _single_headers(scope)
        reason = self._objection(scope, headers)
        if scope["type"] == "websocket":
            if reason is None:
                await self._app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": _REFUSED, "reason": reason})
            return
        guarded = self._with_headers(send)
        if reason is None:
            await self._app(scope, receive, guarded)
        elif reason == _NO_COOKIE and (token := _token(scope)) is not None:
            if self._admits(token):
                await _answer(guarded, 200, _ENTRANCE, {"Content-Type": "text/html", "Set-Cookie": self._set_cookie()})
            else:
                await _answer(guarded, 403, _USED)
        else:
            await _answer(guarded, 403, f"Refused: {reason}. Open the link that dehyst workbench printed.")

    def _objection(self, scope: Scope, headers: dict[str, str]) -> str | None:
        """Return why a request is refused, the cookie last; None if it may pass."""
        origin, method = headers.get("origin"), scope.get("method", "GET")
        changes = scope["type"] == "websocket" or method not in _READING
        # A link that was followed from another site may show the page, which is then without its cookie.
        followed = scope["path"] == "/" and not changes
        objections = {
            "two headers of one name": _TWICE in headers,
            "the Host is not this machine's": headers.get("host") not in self._hosts,
            "the Origin is another page": origin is not None and origin not in self._origins,
            "there is no such method": method not in _METHODS,
            "it was sent by another site": not followed and headers.get("sec-fetch-site", "none") not in _OWN_SITES,
            "the Origin is missing": changes and origin is None,
            _NO_COOKIE: not self._has_cookie(headers),
        }
        return next((words for words, applies in objections.items() if applies), None)

    def _has_cookie(self, headers: dict[str, str]) -> bool:
        try:
            given = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return False
        return given is not None and compare_digest(given.value.encode(), self._key.encode())

    def _set_cookie(self) -> str:
        return f"{self._cookie}={self._key}; HttpOnly; SameSite=Strict; Path=/"

    def _with_headers(self, send: Send) -> Send:
        async def guarded(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                own = {name.decode("latin-1").lower() for name, _ in message.get("headers", ())}
                more = [(k.lower().encode(), v.encode()) for k, v in _HEADERS.items() if k.lower() not in own]
                message = {**message, "headers": [*message.get("headers", ()), *more]}
            await send(message)

        return guarded


def _token(scope: Scope) -> str | None:
    """Return the token of a link that a browser follows; None if there is none."""
    if scope["path"] != "/" or scope["method"] != "GET":
        return None
    return next(iter(parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", ())), None)


def _single_headers(scope: Scope) -> dict[str, str]:
    """Return the headers by name; with `_TWICE` if one that decides comes twice."""
    headers: dict[str, str] = {}
    for raw, value in scope["headers"]:
        name = raw.decode("latin-1").lower()
        if name in headers and name in ("host", "origin", "cookie", "sec-fetch-site"):
            headers[_TWICE] = name
        headers[name] = value.decode("latin-1")
    return headers


async def _answer(send: Send, status: int, words: str, more: dict[str, str] | None = None) -> None:
    headers = {"Content-Type": "text/plain", **(more or {})}
    encoded = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": status, "headers": encoded})
    await send({"type": "http.response.body", "body": words.encode()})
