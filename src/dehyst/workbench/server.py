"""The HTTP interface of a workbench: its page, the event stream, and the requests of the page."""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocketDisconnect

from dehyst._errors import DehystError
from dehyst.web import files
from dehyst.workbench import folder as places
from dehyst.workbench import forms
from dehyst.workbench.data import RequestError, number_of, packed, path_points, record_columns, scan_columns, wasm
from dehyst.workbench.folder import Folder
from dehyst.workbench.reading import columns_of, verified
from dehyst.workbench.session import WorkbenchSession

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

# Least seconds between two messages: many changes are sent together.
_PAUSE = 0.05


class Events:
    """The event stream of one workbench.

    Parameters
    ----------
    state : callable
        Returns the state, as JSON values.
    """

    def __init__(self, state: Callable[[], Mapping[str, Any]]) -> None:
        self._state, self._change = state, asyncio.Event()

    def changed(self) -> None:
        """Send the state soon, once for several changes."""
        before, self._change = self._change, asyncio.Event()
        before.set()

    async def page(self) -> AsyncIterator[str]:
        """Yield the states for one page, the present one first. A slow page receives only the newest state."""
        while True:
            change = self._change
            yield json.dumps(self._state(), allow_nan=False)
            await change.wait()
            await asyncio.sleep(_PAUSE)


_PAGE = Path(__file__).with_name("page")
_TYPES = {".css": "text/css", ".js": "text/javascript"}
# The example record, which is made when it is requested.
EXAMPLE = "virtual-loops.csv"


class PageFiles:
    """The page, its scripts and styles, and an example record."""

    def __init__(self) -> None:
        texts = {name: files.text(name) for name in files.names()}
        texts |= {path.name: path.read_text(encoding="utf-8") for path in _PAGE.iterdir() if path.suffix in _TYPES}
        texts["declared.js"] = f"export const DECLARED = {json.dumps(forms.declared())};\n"
        self._files = {name: (text.encode(), _TYPES[Path(name).suffix]) for name, text in texts.items()}
        self._index = (_PAGE / "index.html").read_text(encoding="utf-8")

    async def index(self, _: Request) -> Response:
        """Return the page."""
        return Response(self._index, media_type="text/html")

    async def file(self, request: Request) -> Response:
        """Return a script, a style or the record to try."""
        name = request.path_params["name"]
        if name == EXAMPLE and name not in self._files:
            self._files[name] = (await asyncio.to_thread(_virtual_loops), "text/csv")
        body, kind = self._files.get(name, (None, None))
        if body is None:
            raise HTTPException(404)
        return Response(body, media_type=kind)


def _virtual_loops() -> bytes:
    """Return loops of a virtual actuator as CSV."""
    from dehyst.operations.demo import record_loops
    from dehyst.records import write_record
    from dehyst.virtual import PlayActuator

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / EXAMPLE
        write_record(file, record_loops(PlayActuator())[0])
        return file.read_bytes()


# A report that is opened from here may run only its own script, and does not get the origin of the workbench.
_SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data:; font-src data:"
)
# Most bytes of a request that is not an upload.
_MOST_JSON = 8_000_000


class TooLargeError(DehystError, ValueError):
    """A request or an upload larger than allowed."""

    status = 413


def _refused(_: Request, error: Exception) -> Response:
    """Answer an error with its fields: status 400 or its own."""
    assert isinstance(error, DehystError)
    return JSONResponse({**error.as_dict(), "error": str(error)}, getattr(error, "status", 400))


def _unusable(_: Request, error: Exception) -> Response:
    """Answer that the disk failed."""
    assert isinstance(error, OSError)
    return JSONResponse({"error": f"the folder cannot be used: {error.strerror}; does it still exist?"}, 500)


def _gone(_: Request, __: Exception) -> Response:
    """Answer a page that was closed: nobody reads the answer."""
    return Response(status_code=400)


_ERRORS = {DehystError: _refused, OSError: _unusable, ClientDisconnect: _gone}
_Handler: TypeAlias = Callable[[Request], Awaitable[Any]]


def _answering(handler: _Handler) -> Callable[[Request], Awaitable[Response]]:
    """Return a handler that answers with the returned JSON values."""

    async def answer(request: Request) -> Response:
        found = await handler(request)
        return found if isinstance(found, Response) else JSONResponse(found or {})

    return answer


def json_of(text: bytes | str) -> dict[str, Any]:
    """Return the JSON object in a text; raise RequestError if there is none."""

    def no_number(word: str) -> float:
        raise ValueError(f"{word} is no number")

    try:
        value = json.loads(text or b"{}", parse_constant=no_number)
        # Half of a surrogate pair can neither be stored nor sent again.
        json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise RequestError(f"the request is no JSON ({error})") from error
    if not isinstance(value, dict):
        raise RequestError("the request is no JSON object")
    return value


async def text_of(request: Request) -> bytes:
    """Return what a request brings, unless it is too large."""
    text = b""
    async for part in request.stream():
        text += part
        if len(text) > _MOST_JSON:
            raise TooLargeError(f"the request has more than {_MOST_JSON / 1e6:g} MB; use a shorter path")
    return text


async def body_of(request: Request) -> dict[str, Any]:
    """Return the JSON object that a request brings."""
    return json_of(await text_of(request))


class Workbench:
    """The requests of the page, for a workbench in a `folder`."""

    def __init__(self, folder: Path) -> None:
        self.session = WorkbenchSession(Folder(folder))
        self.events = Events(self.session.state)
        self.session.changed = self.events.changed

    def app(self) -> Starlette:
        """Return the application."""
        page = PageFiles()
        handlers: dict[str, dict[str, _Handler]] = {
            "GET": {
                "/": page.index,
                "/page/{name}": page.file,
                "/api/state": self.get_state,
                "/api/records/{key}/data": self.record_data,
                "/api/models/{key}/wasm": self.wasm,
                "/api/scan": self.scan,
                "/files/{path:path}": self.file,
            },
            "POST": {
                "/api/excitations": self.excite,
                "/api/records/{key}/read": self.read,
                "/api/models": self.identify,
                "/api/{kind:str}/{key}/end": self.end,
                "/api/models/{key}/{what}": self.work,
            },
            "PUT": {"/api/records": self.upload, "/api/models/{key}/points": self.points},
            "DELETE": {"/api/{kind:str}/{key}": self.delete},
        }
        routes: list[BaseRoute] = [WebSocketRoute("/api/events", self.news)]
        for method, paths in handlers.items():
            routes += [Route(path, _answering(handler), methods=[method]) for path, handler in paths.items()]
        return Starlette(routes=routes, lifespan=self._life, exception_handlers=_ERRORS)

    @asynccontextmanager
    async def _life(self, _: Starlette) -> AsyncIterator[None]:
        yield
        await self.session.close()

    async def news(self, socket: WebSocket) -> None:
        """Send the states to a page until it leaves; what it sends is not listened to."""
        await socket.accept()

        async def send() -> None:
            async for text in self.events.page():
                await socket.send_text(text)

        sending = asyncio.create_task(send())
        try:
            while (await socket.receive())["type"] == "websocket.receive":
                pass
        finally:
            sending.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sending

    async def get_state(self, _: Request) -> Any:
        """Return the state."""
        return self.session.state()

    async def upload(self, request: Request) -> Any:
        """Receive a file, and read it as a record."""
        name = Path(request.query_params.get("name", "record.csv").replace("\\", "/")).name
        place = self.session.folder.new(places.UPLOADS, Path(name).stem, Path(name).suffix[:10])
        with self.session.folder.receive(place) as upload:
            async for part in request.stream():
                upload.write(part)
            if not upload.tell():
                raise RequestError(f"{name}: is empty; choose a file with time, voltage and displacement")
        return {"id": self.session.add_record(place, name).id}

    async def excite(self, request: Request) -> Any:
        """Write an excitation to play."""
        return {"job": self.session.excite(await body_of(request))}

    async def read(self, request: Request) -> Any:
        """Read a record again: with the text of columns, with the values of its form, or with its guesses verified."""
        body, key = await body_of(request), request.path_params["key"]
        columns, values, record = body.get("columns", ""), body.get("form"), self.session.record(key)
        if not isinstance(columns, str) or not isinstance(values, dict | None):
            raise RequestError("columns, form: need a text, or an object with one text for each field")
        if body.get("verified") is True:
            columns = verified(record.columns)
        self.session.read_record(key, columns if values is None else columns_of(record, values))

    async def record_data(self, request: Request) -> Any:
        """Return the columns of a record, or of an axis of it."""
        entry = self.session.record(request.path_params["key"])
        axis = request.query_params.get("axis", entry.axes[0] if entry.axes else "")
        if axis not in (entry.axes or [""]):
            raise RequestError(f"axis: got {axis[:40]!r}, need {', '.join(entry.axes) or 'none'}")
        if not entry.file:
            raise RequestError("the record has no samples yet; wait until it is read")
        columns = await asyncio.to_thread(record_columns, self.session.folder.path / entry.file, axis)
        return Response(packed(columns), media_type="application/octet-stream")

    async def identify(self, request: Request) -> Any:
        """Start an identification."""
        return {"id": self.session.identify(await body_of(request)).id}

    async def work(self, request: Request) -> Any:
        """Start a job on a model."""
        key, what = request.path_params["key"], request.path_params["what"]
        jobs = {name: getattr(self.session, name) for name in ("insight", "check", "update", "follow", "export")}
        if what not in jobs:
            raise HTTPException(404)
        return {"job": jobs[what](key, await body_of(request))}

    async def end(self, request: Request) -> Any:
        """End an identification, or a job."""
        kind, key = request.path_params["kind"], request.path_params["key"]
        (self.session.end if kind == "models" else self.session.cancel)(key)

    async def wasm(self, request: Request) -> Any:
        """Return a model as WebAssembly, for one period between samples."""
        entry = self.session.model(request.path_params["key"], ready=True)
        period = request.query_params.get("period", "0.001")
        try:
            seconds = number_of(float(period), "period")
        except ValueError as error:
            raise RequestError(f"period: got {period[:40]!r}, need seconds") from error
        if entry.axes:
            raise RequestError(f"{entry.name}: has several axes, whose voltages depend on one another; need one axis")
        module = await asyncio.to_thread(wasm, self.session.folder.path / entry.file, seconds)
        return Response(module, media_type="application/wasm")

    async def scan(self, request: Request) -> Any:
        """Return the path of a scan."""
        of = json_of(request.query_params.get("of", ""))
        columns = await asyncio.to_thread(scan_columns, of, of.pop("rate", None))
        return Response(packed(columns), media_type="application/octet-stream")

    async def points(self, request: Request) -> Any:
        """Return the points of a path in a file."""
        entry = self.session.model(request.path_params["key"], ready=True)
        suffix = Path(request.query_params.get("name", "path.csv")).suffix[:10].replace("\0", "")
        with tempfile.TemporaryDirectory(prefix="dehyst-") as place:
            file = Path(place) / f"path{suffix}"
            file.write_bytes(await text_of(request))
            return {"points": await asyncio.to_thread(path_points, file, self.session.folder.path / entry.file)}

    async def delete(self, request: Request) -> Any:
        """Remove an entry from the list."""
        self.session.delete(request.path_params["key"])

    async def file(self, request: Request) -> Any:
        """Return a file of the folder."""
        relative = request.path_params["path"]
        path = self.session.folder.inside(relative)
        if path.suffix == ".html" and not relative.startswith(places.UPLOADS):
            return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": _SANDBOX})
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)
