"""News for all open pages: the state when it changed, and live samples."""

from __future__ import annotations

import asyncio
import json
import mimetypes
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocketDisconnect

from dehyst._errors import DehystError
from dehyst._io import read_json
from dehyst.waveforms.named import OPTIONS, SCANS
from dehyst.web import files
from dehyst.workbench import folder as places
from dehyst.workbench.folder import Folder
from dehyst.workbench.jobs import packed, record_columns, trace_columns, trace_heads, voltage_columns, wasm
from dehyst.workbench.requests import (
    RequestError,
    TooLargeError,
    answered,
    archived,
    body_of,
    number_of,
    requested,
    scan_columns,
)
from dehyst.workbench.rig_desk import RigDesk
from dehyst.workbench.session import WorkbenchSession

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

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


_PAGE = Path(__file__).with_name("page")
_TYPES = {".css": "text/css", ".js": "text/javascript"}
_SCRIPTS = '<script type="module"'
EXAMPLE = "example.csv"
# Not of the page: its worker, and what only reports have.
_APART = ("keepalive.js", "path_trial.js", "report.css")


class PageFiles:
    """The page, and the scripts and styles that it asks for.

    A module names others, and these others: a browser would find them one round after another. The page lists all.
    """

    def __init__(self) -> None:
        texts = {name: files.text(name) for name in files.names()}
        texts |= {one.name: one.read_text(encoding="utf-8") for one in _PAGE.iterdir() if one.suffix in _TYPES}
        self._files = {name: (text.encode(), _TYPES[Path(name).suffix]) for name, text in texts.items()}
        self._files["scan_options.js"] = (_scan_options().encode(), _TYPES[".js"])
        scripts = sorted(name for name in self._files if name.endswith(".js") and name not in _APART)
        links = "".join(f'<link rel="modulepreload" href="/page/{name}">\n' for name in scripts)
        page = (_PAGE / "index.html").read_text(encoding="utf-8")
        self._index = page.replace(_SCRIPTS, links + _SCRIPTS, 1)

    async def index(self, _: Request) -> Response:
        """Return the page."""
        return Response(self._index, media_type="text/html")

    async def file(self, request: Request) -> Response:
        """Return a script, a style or the example."""
        name = request.path_params["name"]
        if name == EXAMPLE and name not in self._files:
            self._files[name] = (await asyncio.to_thread(_example), "text/csv")
        body, kind = self._files.get(name, (None, None))
        if body is None:
            raise HTTPException(404)
        return Response(body, media_type=kind)


def _scan_options() -> str:
    """Return a module with the declaration of the named scans and their options."""
    options = {
        name: {**option._asdict(), "kind": option.kind.__name__ if isinstance(option.kind, type) else option.kind}
        for name, option in OPTIONS.items()
    }
    scans = {name: {"needs": scan.needs, "may": scan.may} for name, scan in SCANS.items()}
    return f"export const DECLARED = {json.dumps({'options': options, 'scans': scans})};\n"


def _example() -> bytes:
    """Return loops of a virtual actuator as CSV, for those who have no record yet."""
    from dehyst.records import write_record
    from dehyst.studies.demo import record_loops
    from dehyst.virtual import PlayActuator

    with TemporaryDirectory() as folder:
        file = Path(folder) / EXAMPLE
        write_record(file, record_loops(PlayActuator())[0])
        return file.read_bytes()


# The computer's own table may have others, and the page's types are not guessed by browsers.
mimetypes.add_type("text/javascript", ".js")
mimetypes.add_type("text/css", ".css")
# What a page that dehyst wrote may do when it is opened from here: nothing but run its own script, without this origin.
_SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data:; font-src data:"
)


# Code with which a WebSocket is closed that sent something else than text.
_NO_TEXT = 1003


class Workbench:
    """The requests of a workbench's page.

    Parameters
    ----------
    folder : Path
    upload_limit : float
        Most bytes of an upload.
    origins : sequence of str
        Of the page.
    """

    def __init__(self, folder: Path, upload_limit: float, origins: Sequence[str]) -> None:
        self.upload_limit = int(upload_limit)
        self.events = Events(self.state)
        self.session = WorkbenchSession(Folder(folder), self.events.changed)
        self.rig = RigDesk(self.session.folder, self.session.touch, self.events.send, origins, self._finished)

    def app(self) -> Starlette:
        """Return the application."""
        get, post, page = ["GET"], ["POST"], PageFiles()
        routes = [
            Route("/", page.index, methods=get),
            Route("/page/{name}", page.file, methods=get),
            Route("/api/state", self.get_state, methods=get),
            WebSocketRoute("/api/events", self.news),
            Route("/api/records", self.upload, methods=["PUT"]),
            Route("/api/records/{key}/read", self.read, methods=post),
            Route("/api/records/{key}/data", self.record_data, methods=get),
            Route("/api/models", self.identify, methods=post),
            Route("/api/models/{key}/end", self.end, methods=post),
            Route("/api/models/{key}/fit", self.fit, methods=get),
            Route("/api/models/{key}/wasm", self.wasm, methods=get),
            Route("/api/models/{key}/traces", self.traces, methods=get),
            Route("/api/models/{key}/traces/{number:int}", self.trace, methods=get),
            Route("/api/models/{key}/insight", self.insight, methods=post),
            Route("/api/models/{key}/path", self.path, methods=post),
            Route("/api/models/{key}/export", self.export, methods=post),
            Route("/api/scan", self.scan, methods=get),
            Route("/api/voltages/{key}/data", self.voltage_data, methods=get),
            Route("/api/jobs/{key}/cancel", self.cancel, methods=post),
            Route("/api/rig/{what}", self.drive, methods=post),
            Route("/api/{kind:str}/{key}", self.delete, methods=["DELETE"]),
            Route("/files/{path:path}", self.file, methods=get),
        ]
        return Starlette(routes=routes, lifespan=self._life)

    def state(self) -> dict[str, Any]:
        """Return what all pages show."""
        return {**self.session.state(), "upload_limit": self.upload_limit, "rig": self.rig.state}

    @asynccontextmanager
    async def _life(self, _: Starlette) -> AsyncIterator[None]:
        await self.rig.recover()
        yield
        # First what moves.
        await self.rig.close()
        await self.session.close()

    def _finished(self, place: str) -> None:
        """List what the rig left: a record, or the model of a calibration."""
        if place.startswith(f"{places.RECORDS}/"):
            # A journal beside its file is that of a listed record.
            if all(record.source != place for record in self.session.records.values()):
                self.session.add_record(place, Path(place).name)
            return
        with suppress(DehystError):
            self.session.add_calibrated(place, read_json(self.session.folder.path / place / "calibration.json"))

    async def get_state(self, _: Request) -> Response:
        """Return the state."""
        return JSONResponse(self.state())

    async def news(self, socket: WebSocket) -> None:
        """Send the news to a page, and listen to its heartbeat."""
        await socket.accept()

        async def send() -> None:
            async for message in self.events.page():
                await socket.send_text(message)

        sending = asyncio.create_task(send())
        try:
            while (message := await socket.receive())["type"] == "websocket.receive":
                if message.get("text") is None:
                    await socket.close(_NO_TEXT)
                    break
                self.rig.heard()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await sending

    @answered
    async def upload(self, request: Request) -> Response:
        """Receive a file, and read it as a record."""
        name = Path(request.query_params.get("name", "record.csv").replace("\\", "/")).name
        place = self.session.folder.new(places.UPLOADS, Path(name).stem, Path(name).suffix[:10])
        declared = request.headers.get("content-length", "0")
        with self.session.folder.receive(place) as upload:
            self._demand_size(int(declared) if declared.isdigit() else 0)
            async for part in request.stream():
                self._demand_size(upload.size + len(part))
                upload.add(part)
            if not upload.size:
                raise RequestError(f"{name}: is empty; choose a file with time, voltage and displacement")
            upload.complete()
        return JSONResponse({"id": self.session.add_record(place, name).id})

    def _demand_size(self, size: int) -> None:
        if size > self.upload_limit:
            raise TooLargeError(
                f"the file has more than {self.upload_limit / 1e6:.6g} MB; cut or resample it, or start dehyst "
                "workbench with a larger --max-size"
            )

    @answered
    async def read(self, request: Request) -> Response:
        """Read a record again, with options."""
        options = (await body_of(request)).get("options", {})
        if not isinstance(options, dict):
            raise RequestError("options: need an object with a text for each option")
        self.session.read_record(request.path_params["key"], options)
        return JSONResponse({})

    @answered
    async def record_data(self, request: Request) -> Response:
        """Return the columns of a record."""
        entry = self.session.record(request.path_params["key"])
        return await self._columns(record_columns, entry.file)

    @answered
    async def identify(self, request: Request) -> Response:
        """Start an identification."""
        return JSONResponse({"id": self.session.identify(await body_of(request)).id})

    @answered
    async def end(self, request: Request) -> Response:
        """End an identification."""
        self.session.end(request.path_params["key"])
        return JSONResponse({})

    @answered
    async def fit(self, request: Request) -> Response:
        """Return the numbers of a fit."""
        entry = self.session.model(request.path_params["key"], ready=True)
        return FileResponse(self.session.folder.path / entry.fit, media_type="application/json")

    @answered
    async def wasm(self, request: Request) -> Response:
        """Return a model as WebAssembly, for one period between samples."""
        entry = self.session.model(request.path_params["key"], ready=True)
        period = request.query_params.get("period", "0.001")
        try:
            seconds = number_of(float(period), "period")
        except ValueError as error:
            raise RequestError(f"period: got {period[:40]!r}, need seconds") from error
        module = await asyncio.to_thread(wasm, self.session.folder.path / entry.file, seconds)
        return Response(module, media_type="application/wasm")

    @answered
    async def traces(self, request: Request) -> Response:
        """Return which records a model has traces of."""
        entry = self.session.model(request.path_params["key"], ready=True)
        return JSONResponse(await asyncio.to_thread(trace_heads, self.session.folder.path / entry.traces))

    @answered
    async def trace(self, request: Request) -> Response:
        """Return the columns of a trace."""
        entry = self.session.model(request.path_params["key"], ready=True)
        number = request.path_params["number"]
        if not 0 <= number < len(entry.table):
            raise RequestError(f"{number}: there is no such trace; {entry.name} has {len(entry.table)}")
        return await self._columns(lambda file: trace_columns(file, number), entry.traces)

    @answered
    async def scan(self, request: Request) -> Response:
        """Return the path of a scan."""
        of = requested(request.query_params.get("of", ""))
        scan = {name: value for name, value in of.items() if name != "rate"}
        columns = await asyncio.to_thread(scan_columns, scan, of.get("rate"))
        return Response(packed(columns), media_type="application/octet-stream")

    @answered
    async def voltage_data(self, request: Request) -> Response:
        """Return the columns of a voltage."""
        entry = self.session.voltage(request.path_params["key"])
        return await self._columns(voltage_columns, entry.file)

    @answered
    async def insight(self, request: Request) -> Response:
        """Start an assessment."""
        return JSONResponse({"job": self.session.insight(request.path_params["key"])})

    @answered
    async def path(self, request: Request) -> Response:
        """Start the computation of a voltage."""
        return JSONResponse({"job": self.session.follow(request.path_params["key"], await body_of(request))})

    @answered
    async def export(self, request: Request) -> Response:
        """Start an export."""
        body = await body_of(request)
        kind = str(body.pop("kind", ""))
        return JSONResponse({"job": self.session.export(request.path_params["key"], kind, body)})

    @answered
    async def cancel(self, request: Request) -> Response:
        """End a job."""
        self.session.cancel(request.path_params["key"])
        return JSONResponse({})

    @answered
    async def drive(self, request: Request) -> Response:
        """Do something with the rig."""
        body = await body_of(request)
        if "voltage" in body:
            body["file"] = self.session.voltage(str(body.pop("voltage"))).file
        await self.rig.request(request.path_params["what"], body)
        return JSONResponse({})

    @answered
    async def delete(self, request: Request) -> Response:
        """Take an entry from the list."""
        self.session.delete(request.path_params["key"])
        return JSONResponse({})

    @answered
    async def file(self, request: Request) -> Response:
        """Return a file of the folder, or a folder of it as a ZIP archive."""
        relative = request.path_params["path"]
        path = self.session.folder.inside(relative)
        if path.is_dir():
            return await archived(path)
        if path.suffix == ".html" and not relative.startswith(places.UPLOADS):
            return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": _SANDBOX})
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    async def _columns(self, columns: Callable[[Path], Any], file: str) -> Response:
        if not file:
            raise RequestError("it has no samples yet; wait until it is read")

        def pack() -> bytes:
            return packed(columns(self.session.folder.path / file))

        return Response(await asyncio.to_thread(pack), media_type="application/octet-stream")
