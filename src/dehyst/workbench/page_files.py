"""The files of the page, read once: about a hundred kilobytes."""

from __future__ import annotations

from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from dehyst.exports.shipped import shipped

_PAGE = Path(__file__).with_name("page")
_TYPES = {".css": "text/css", ".js": "text/javascript"}
_SCRIPTS = '<script type="module"'


class PageFiles:
    """The page, and the scripts and styles that it asks for.

    A module names others, and these others: a browser would find them one round after another. The page lists all.
    """

    def __init__(self) -> None:
        own = [one for one in _PAGE.iterdir() if one.suffix in _TYPES]
        self._files = {one.name: (one.read_bytes(), _TYPES[one.suffix]) for one in own}
        self._files["dehyst.js"] = (shipped("compensator.js").encode(), _TYPES[".js"])
        scripts = sorted(name for name in self._files if name.endswith(".js"))
        links = "".join(f'<link rel="modulepreload" href="/page/{name}">\n' for name in scripts)
        page = (_PAGE / "index.html").read_text(encoding="utf-8")
        self._index = page.replace(_SCRIPTS, links + _SCRIPTS, 1)

    async def index(self, _: Request) -> Response:
        """Return the page."""
        return Response(self._index, media_type="text/html")

    async def file(self, request: Request) -> Response:
        """Return a script or a style."""
        body, kind = self._files.get(request.path_params["name"], (None, None))
        if body is None:
            raise HTTPException(404)
        return Response(body, media_type=kind)
