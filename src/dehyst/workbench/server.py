"""The server of a workbench: its page, its files and its requests, on this machine only."""

from __future__ import annotations

import asyncio
import mimetypes
from collections.abc import Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocketDisconnect

from dehyst._errors import DehystError
from dehyst._io.json_files import read_json
from dehyst.workbench import folder as places
from dehyst.workbench import results
from dehyst.workbench.answers import TooLargeError, answered, archived, body_of
from dehyst.workbench.events import Events
from dehyst.workbench.folder import Folder
from dehyst.workbench.page_files import PageFiles
from dehyst.workbench.requests import RequestError, number_of
from dehyst.workbench.rig_desk import RigDesk
from dehyst.workbench.scan_preview import requested, scan_columns
from dehyst.workbench.session import WorkbenchSession

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from starlette.requests import Request
    from starlette.websockets import WebSocket

# The computer's own table may have others, and the page's types are not guessed by browsers.
mimetypes.add_type("text/javascript", ".js")
mimetypes.add_type("text/css", ".css")
# What a page that dehyst wrote may do when it is opened from here: nothing but run its own script, without this origin.
_SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data:; font-src data:"
)


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
        yield
        # First what moves.
        await self.rig.close()
        await self.session.close()

    def _finished(self, place: str) -> None:
        """List what the rig left: a record, or the model of a calibration."""
        if place.startswith(f"{places.RECORDS}/"):
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
            while True:
                await socket.receive_text()
                self.rig.heard()
        except (WebSocketDisconnect, RuntimeError, KeyError):
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
        return await self._columns(results.record_columns, entry.file)

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
        module = await asyncio.to_thread(results.wasm, self.session.folder.path / entry.file, seconds)
        return Response(module, media_type="application/wasm")

    @answered
    async def traces(self, request: Request) -> Response:
        """Return which records a model has traces of."""
        entry = self.session.model(request.path_params["key"], ready=True)
        heads = await asyncio.to_thread(results.trace_heads, self.session.folder.path / entry.traces)
        return JSONResponse({"records": heads})

    @answered
    async def trace(self, request: Request) -> Response:
        """Return the columns of a trace."""
        entry = self.session.model(request.path_params["key"], ready=True)
        number = request.path_params["number"]
        if not 0 <= number < len(entry.table):
            raise RequestError(f"{number}: there is no such trace; {entry.name} has {len(entry.table)}")
        return await self._columns(lambda file: results.trace_columns(file, number), entry.traces)

    @answered
    async def scan(self, request: Request) -> Response:
        """Return the path of a scan."""
        of = requested(request.query_params.get("of", ""))
        scan = {name: value for name, value in of.items() if name != "rate"}
        columns = await asyncio.to_thread(scan_columns, scan, of.get("rate"))
        return Response(results.packed(columns), media_type="application/octet-stream")

    @answered
    async def voltage_data(self, request: Request) -> Response:
        """Return the columns of a voltage."""
        entry = self.session.voltage(request.path_params["key"])
        return await self._columns(results.voltage_columns, entry.file)

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
            return results.packed(columns(self.session.folder.path / file))

        return Response(await asyncio.to_thread(pack), media_type="application/octet-stream")
