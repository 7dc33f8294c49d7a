"""Requests of the page: their JSON, checked, as words of a command; and errors as answers."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Awaitable, Callable, Iterable, Mapping
from functools import wraps
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect
from starlette.responses import FileResponse, JSONResponse, Response

from dehyst._errors import DehystError
from dehyst._types import Array
from dehyst.records import write_columns
from dehyst.waveforms.named import OPTIONS, SCANS, scan_of
from dehyst.workbench import folder as places
from dehyst.workbench.entries import ModelEntry
from dehyst.workbench.folder import Folder

if TYPE_CHECKING:
    from starlette.requests import Request

_TEXTS = ("columns", "time", "voltage", "displacement", "voltage_scale", "displacement_scale")
_KINDS: dict[str, type | tuple[str, ...]] = {
    **dict.fromkeys(_TEXTS, str),
    "decimal": (".", ","),
    "sample_rate": float,
    "structure": ("auto", "maxwell_slip"),
    "norm": ("l1", "l2", "linf"),
    "goal": float,
    "time_limit": float,
    "sensor_lag": float,
}
_READ = (*_TEXTS, "decimal", "sample_rate")
_IDENTIFY = ("structure", "norm", "goal", "time_limit", "sensor_lag")
# Options of a scan that is played, beside those of the scan.
_PLAYED: dict[str, Any] = {"sample_rate": float, "cycles": int, "axis": ("x", "y")}
_SCAN_KINDS = {name: option.kind for name, option in OPTIONS.items()} | _PLAYED
_LONGEST = 1000
# Samples of a path that is drawn.
_MOST_SAMPLES = 10_000_000


class RequestError(DehystError, ValueError):
    """A request that is not understood: what was got, what is needed."""


def read_words(source: str, file: str, options: Mapping[str, Any]) -> list[str]:
    """Return the command that reads an uploaded file and writes the record in SI units."""
    # A record is a measurement, which is not replaced without --force: here by the same file, read otherwise.
    return ["show", source, "-o", file, "--force", "--json", *_options(options, _READ)]


def identify_words(entry: ModelEntry, train: list[str], validate: list[str]) -> list[str]:
    """Return the command that identifies a model."""
    held_out = ["--validate", *validate] if validate else []
    outputs = ["-o", entry.file, "--traces", entry.traces, "--report", entry.report, "--json"]
    return ["identify", *train, *outputs, *_options(entry.options, _IDENTIFY), *held_out]


def path_words(model: str, file: str, request: Mapping[str, Any], path: str | None) -> list[str]:
    """Return the command that computes the voltage for a `path`, or for the request's scan."""
    words = ["compensate", model]
    if path is not None:
        words.append(path)
    else:
        words += scan_words(request.get("scan"), request.get("rate"))
    words += ["-o", file, "--json"]
    if (limits := request.get("limits")) is not None:
        words += ["--limits", *map(repr, limits_of(limits))]
    if (slew := request.get("slew")) is not None:
        words += ["--slew", "none" if slew == "none" else repr(number_of(slew, "slew"))]
    return words


def export_words(folder: Folder, model: ModelEntry, kind: str, request: Mapping[str, Any]) -> list[str]:
    """Return the command that exports a model."""
    name = Path(model.file).stem
    if kind == "c":
        return ["export", model.file, folder.new(places.EXPORTS, f"{name}-c"), "--json"]
    if kind == "fmu":
        return ["export", model.file, folder.new(places.EXPORTS, name, ".fmu"), "--fmu", "--json"]
    if kind == "wasm":
        return ["export", model.file, folder.new(places.EXPORTS, name, ".wasm"), "--json"]
    if kind == "wave_table":
        table = folder.new(places.EXPORTS, f"{name}-cycle", ".csv")
        file = folder.new(places.VOLTAGES, f"{name}-cycle", ".csv")
        return [*path_words(model.file, file, request, None), "--cycle", table]
    raise RequestError(f"kind: got {kind!r}, need c, fmu, wasm or wave_table")


def written_path(file: Path, points: Any, rate: Any) -> None:
    """Write a path through points (time [s], displacement [um]), with straight lines between them, as CSV.

    Raises
    ------
    RequestError
        The points are not two at least with rising times, or the rate [Hz] asks for too many samples.
    """
    hertz = number_of(rate, "rate")
    try:
        corners = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RequestError("points: need pairs of a time (s) and a displacement (um)") from error
    if corners.ndim != 2 or corners.shape[0] < 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise RequestError("points: need two at least, each a time (s) and a displacement (um)")
    time = corners[:, 0]
    if not (np.diff(time) > 0).all():
        raise RequestError("points: their times do not rise; move the points apart")
    samples = (time[-1] - time[0]) * hertz
    if not 1 <= samples <= _MOST_SAMPLES:
        raise RequestError(
            f"rate: {hertz:g} Hz gives {samples:.4g} samples, need 1 to {_MOST_SAMPLES:g}; give another rate"
        )
    sampled = time[0] + np.arange(round(samples) + 1) / hertz
    write_columns(file, {"time_s": sampled, "displacement_um": np.interp(sampled, time, corners[:, 1])}, digits=12)


def limits_of(value: Any) -> tuple[float, float]:
    """Return voltage limits [V] from a request."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise RequestError("limits: need the lowest and the highest voltage (V)")
    low, high = (number_of(one, "limits") for one in value)
    if not low < high:
        raise RequestError(f"limits: got {low:g} to {high:g} V, need the lower one first")
    return low, high


def number_of(value: Any, name: str) -> float:
    """Return a finite number from a request."""
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else inf
    except OverflowError:
        number = inf
    if not isfinite(number):
        raise RequestError(f"{name}: got {str(value)[:40]!r}, need a number")
    return number


def _options(given: Mapping[str, Any], known: Iterable[str]) -> list[str]:
    """Return options as words: each with its value in one word, so that no value is taken for an option."""
    if unknown := set(given) - set(known):
        raise RequestError(f"options: got {sorted(unknown)[0]!r}, need some of {', '.join(known)}")
    words = []
    for name, value in given.items():
        if value is not None and value != "":
            words.append(f"--{name.replace('_', '-')}={_text(name, value, _KINDS[name])}")
    return words


def _text(name: str, value: Any, kind: type | tuple[str, ...]) -> str:
    if kind is float:
        return repr(number_of(value, name))
    if isinstance(kind, tuple):
        if value not in kind:
            raise RequestError(f"{name}: got {str(value)[:40]!r}, need {' or '.join(kind)}")
        return str(value)
    if not isinstance(value, str) or len(value) > _LONGEST or "\0" in value:
        raise RequestError(f"{name}: need a text of at most {_LONGEST} letters")
    return value


def scan_words(scan: Any, rate: Any) -> list[str]:
    """Return a scan as options of `dehyst compensate`."""
    kind, given = _scan(scan, rate)
    words = ["--scan", kind]
    for name, value in given.items():
        flag, parts = f"--{name.replace('_', '-')}", [value] if not isinstance(value, list) else value
        texts = [part if isinstance(part, str) else f"{part:.12g}" for part in parts]
        words += [flag, *texts] if _SCAN_KINDS[name] == "pair" else [f"{flag}={','.join(texts)}"]
    return words


def _scan(scan: Any, rate: Any) -> tuple[str, dict[str, Any]]:
    """Return the kind of a scan and its options, checked, without those that are empty."""
    if not isinstance(scan, Mapping) or scan.get("kind") not in SCANS:
        raise RequestError(f"scan: need one of {', '.join(SCANS)}, or points")
    given = {"sample_rate": rate, **{name: value for name, value in scan.items() if name != "kind"}}
    given = {name: value for name, value in given.items() if value is not None and value != ""}
    return scan["kind"], {name: _scan_value(name, value) for name, value in given.items()}


def _scan_value(name: str, value: Any) -> Any:
    kind = _SCAN_KINDS.get(name)
    if isinstance(kind, tuple):
        return _text(name, value, kind)
    if kind is float:
        return number_of(value, name)
    if kind is int:
        return _whole(value, name)
    if kind is None or not isinstance(value, list) or (kind == "pair" and len(value) != 2):
        raise RequestError(f"scan: got {str(name)[:40]!r}, which is not an option of a scan, or not of that kind")
    return [_whole(one, name) if kind == "pair" else number_of(one, name) for one in value]


def _whole(value: Any, name: str) -> int:
    number = number_of(value, name)
    if not number.is_integer():
        raise RequestError(f"{name}: got {number:g}, need a whole number")
    return int(number)


# Bytes of a request that is not an upload.
_MOST_JSON = 8_000_000
_T = TypeVar("_T")


class TooLargeError(DehystError, ValueError):
    """A request or an upload larger than allowed."""

    status = 413


def answered(handler: Callable[[_T, Request], Awaitable[Response]]) -> Callable[[_T, Request], Awaitable[Response]]:
    """Answer an error as a sentence: of dehyst with its own status or 400, of the disk with 500."""

    @wraps(handler)
    async def answer(self: _T, request: Request) -> Response:
        try:
            return await handler(self, request)
        except ClientDisconnect:
            # Nobody reads this answer.
            return Response(status_code=400)
        except DehystError as error:
            return JSONResponse({"error": str(error)}, getattr(error, "status", 400))
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
    """Return a folder as a ZIP archive: its own files and folders, no links."""
    place = Path(tempfile.mkdtemp(prefix="dehyst-"))
    remove = BackgroundTask(shutil.rmtree, place, ignore_errors=True)
    archive = place / f"{folder.name}.zip"
    await asyncio.to_thread(_archive, folder, archive)
    return FileResponse(archive, filename=archive.name, background=remove)


def _archive(folder: Path, archive: Path) -> None:
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as writer:
        for place, _, names in os.walk(folder):
            for path in (Path(place), *(Path(place) / name for name in sorted(names))):
                if path == Path(place) or stat.S_ISREG(path.lstat().st_mode):
                    writer.write(path, path.relative_to(folder.parent))


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


_MICRO = 1e6
# Samples that a page draws.
_MOST_DRAWN = 2_000_000


def scan_columns(scan: Any, rate: Any) -> tuple[Array, Array]:
    """Return time [s] and displacement [um] of a scan that was requested, sampled at a rate [Hz].

    Raises
    ------
    RequestError
        The request is no scan, or has too many samples.
    RecordError
        The scan is impossible.
    """
    kind, given = _scan(scan, rate)
    hertz, axis, cycles = given.pop("sample_rate", None), given.pop("axis", "x"), given.pop("cycles", 1)
    hertz = number_of(hertz, "rate")
    path = scan_of(kind, given, hertz).path(axis)
    if len(path) * cycles > _MOST_DRAWN:
        raise RequestError(
            f"rate: {hertz:g} Hz gives {len(path) * cycles} samples, need {_MOST_DRAWN} at most to draw them; give "
            "a lower rate"
        )
    whole = path.repeated(cycles) if path.periodic else path
    return np.arange(len(whole)) / hertz, whole.displacement * _MICRO


def requested(text: str) -> Mapping[str, Any]:
    """Return the request in a query's JSON."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"scan: the request is no JSON ({error})") from error
    if not isinstance(value, dict):
        raise RequestError("scan: the request is no JSON object")
    return value
