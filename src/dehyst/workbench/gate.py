"""Access control of the server."""

from __future__ import annotations

import secrets
from collections.abc import MutableMapping
from hmac import compare_digest
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

_READING = ("GET", "HEAD")
_METHODS = (*_READING, "POST", "PUT", "DELETE")
# The values of a request that the page itself or the user made.
_OWN_SITES = ("same-origin", "none")
# Headers that decide about access; each may appear only once.
_DECIDING = ("host", "origin", "cookie", "sec-fetch-site")
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
_EARLIER = "Refused: this link is from an earlier workbench. Open the link that dehyst workbench printed last."
# The page behind the link. A browser sends the cookie with requests of this page, but perhaps not with a request that
# another site or a file started. The icon is empty, because the workbench has none at /favicon.ico.
_ENTRANCE = (
    '<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=/"><title>dehyst workbench</title>'
    '<link rel="icon" href="data:,"><a href="/">Open the workbench</a>'
)


class Gate:
    """An ASGI application that protects another one.

    Parameters
    ----------
    app : callable
        The protected application.
    port : int
        At which the server listens.
    token : str
        Of the link ``/?token=...``, which lets a browser in.
    """

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app, self._key = app, secrets.token_urlsafe(32)
        self._token = token
        self._cookie = f"dehyst-{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        reason = self._objection(asked)
        if scope["type"] == "http":
            answer = self._app if reason is None else self._refusal(asked, reason)
            await answer(scope, receive, _with_headers(send))
        elif reason is None:
            await self._app(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": _REFUSED, "reason": reason})

    def _objection(self, asked: HTTPConnection) -> str | None:
        """Return why a request is refused, None if it is allowed; the cookie is checked last."""
        scope, headers = asked.scope, asked.headers
        origin, method = headers.get("origin"), scope.get("method", "GET")
        changes = scope["type"] == "websocket" or method not in _READING
        # A link on another site may lead to the page; then the browser sends no cookie.
        followed = scope["path"] == "/" and not changes
        objections = {
            "two headers have the same name": any(len(headers.getlist(name)) > 1 for name in _DECIDING),
            "the Host is not this machine": headers.get("host") not in self._hosts,
            "the Origin is another page": origin is not None and origin not in self._origins,
            "there is no such method": method not in _METHODS,
            "it was sent by another site": not followed and headers.get("sec-fetch-site", "none") not in _OWN_SITES,
            "the Origin is missing": changes and origin is None,
            _NO_COOKIE: not compare_digest(asked.cookies.get(self._cookie, "").encode(), self._key.encode()),
        }
        return next((words for words, applies in objections.items() if applies), None)

    def _refusal(self, asked: HTTPConnection, reason: str) -> Response:
        """Return the answer to a refused request, or the cookie if the request has a valid link."""
        token = asked.query_params.get("token")
        follows = asked.scope["path"] == "/" and asked.scope["method"] == "GET" and token is not None
        if reason != _NO_COOKIE or not follows:
            return PlainTextResponse(f"Refused: {reason}. Open the link that dehyst workbench printed.", 403)
        if not compare_digest(str(token).encode(), self._token.encode()):
            return PlainTextResponse(_EARLIER, 403)
        cookie = f"{self._cookie}={self._key}; HttpOnly; SameSite=Strict; Path=/"
        return HTMLResponse(_ENTRANCE, headers={"Set-Cookie": cookie})


def _with_headers(send: Send) -> Send:
    """Return a `send` that adds the headers of every answer."""

    async def guarded(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return guarded
