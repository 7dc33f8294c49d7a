"""What all requests share: the JSON that they bring, and errors as sentences."""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
from collections.abc import Awaitable, Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from starlette.background import BackgroundTask
from starlette.responses import FileResponse, JSONResponse, Response

from dehyst._errors import DehystError
from dehyst.workbench.requests import RequestError

if TYPE_CHECKING:
    from starlette.requests import Request

# Bytes of a request that is not an upload.
_MOST_JSON = 8_000_000
_T = TypeVar("_T")


class TooLargeError(DehystError, ValueError):
    """A request or an upload larger than allowed."""


def answered(handler: Callable[[_T, Request], Awaitable[Response]]) -> Callable[[_T, Request], Awaitable[Response]]:
    """Answer an error as a sentence: of dehyst with status 400 (too large: 413), of the disk with 500."""

    @wraps(handler)
    async def answer(self: _T, request: Request) -> Response:
        try:
            return await handler(self, request)
        except DehystError as error:
            return JSONResponse({"error": str(error)}, 413 if isinstance(error, TooLargeError) else 400)
        except OSError as error:
            return JSONResponse({"error": f"the folder cannot be used: {error.strerror}; is it still there?"}, 500)

    return answer


async def body_of(request: Request) -> dict[str, Any]:
    """Return the JSON object that a request brings."""
    text = b""
    async for part in request.stream():
        text += part
        if len(text) > _MOST_JSON:
            raise TooLargeError(f"the request has more than {_MOST_JSON / 1e6:g} MB; draw a shorter path")
    try:
        value = json.loads(text or b"{}", parse_constant=_no_number)
        # A half of a letter outside the basic plane can neither be stored nor sent again.
        json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise RequestError(f"the request is no JSON ({error})") from error
    if not isinstance(value, dict):
        raise RequestError("the request is no JSON object")
    return value


async def archived(folder: Path) -> Response:
    """Return a folder as a ZIP archive."""
    place = Path(tempfile.mkdtemp(prefix="dehyst-"))
    remove = BackgroundTask(shutil.rmtree, place, ignore_errors=True)
    archive = await asyncio.to_thread(shutil.make_archive, str(place / folder.name), "zip", folder.parent, folder.name)
    return FileResponse(archive, filename=Path(archive).name, background=remove)


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")
