"""The session of a workbench: records, models and voltages, and the operations on them.

It depends on neither HTTP nor a browser. All work is done by operations in worker processes and noted as commands in
the folder's script.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from dehyst._errors import DehystError, FileFormatError
from dehyst._io import finite
from dehyst.operations.files import RECORD, Columns, is_model
from dehyst.workbench import folder as places
from dehyst.workbench.data import number_of, scan_words, written_path
from dehyst.workbench.entries import ExcitationEntry, ModelEntry, RecordEntry, VoltageEntry, verdict_of, worst
from dehyst.workbench.folder import Folder
from dehyst.workbench.forms import EXPORTS
from dehyst.workbench.jobs import Finished, Jobs, Worker, words_of
from dehyst.workbench.reading import form_of

_T = TypeVar("_T")
# Seconds between a change and its writing to the disk.
_SOON = 0.5
# Most columns of a file that the page offers as choices.
_MOST_COLUMNS = 500
_NO_RECORD = (
    "this is a model, but the page shows only models that it identified: drop the training record of the model, or use "
    "the model in a terminal (dehyst check, dehyst compensate)"
)
# Options of an identification that the page may give.
_IDENTIFY = ("structure", "goal", "time_limit", "sensor_lag")
# The values of a path.
_PATH = ("scan", "points", "file", "low", "high", "slew", "rate")

_KINDS = {"records": RecordEntry, "models": ModelEntry, "voltages": VoltageEntry, "excitations": ExcitationEntry}


class SessionError(DehystError, ValueError):
    """A request that the session cannot fulfil."""


class WorkbenchSession:
    """A workbench without its page.

    Parameters
    ----------
    folder : Folder
    changed : callable
        Called after each change of the state.
    worker : callable
        Makes a worker; for tests.
    """

    def __init__(
        self,
        folder: Folder,
        changed: Callable[[], None] = lambda: None,
        worker: Callable[[Path], Worker] = Worker,
    ) -> None:
        self.folder = folder
        self.records: dict[str, RecordEntry]
        self.models: dict[str, ModelEntry]
        self.voltages: dict[str, VoltageEntry]
        self.excitations: dict[str, ExcitationEntry]
        self.changed, self._last = changed, 0
        self._saving: asyncio.TimerHandle | None = None
        self.jobs = Jobs(folder, self.touch, worker)
        try:
            self._take_up(folder.saved())
        except (TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                f"{folder.path / places.STATE}: is damaged ({error}); move it elsewhere, or give another folder"
            ) from error

    def state(self) -> dict[str, Any]:
        """Return the state that the page shows, as JSON values."""
        state: dict[str, Any] = finite(
            {
                "folder": self.folder.path.name,
                **self._entries(),
                "records": [{**asdict(record), "form": form_of(record)} for record in self.records.values()],
                "jobs": [asdict(job) for job in self.jobs.entries.values()],
                "files": list(self.folder.files()),
                "log": self.folder.commands(),
            }
        )
        return state

    def record(self, key: str) -> RecordEntry:
        """Return a record; raise SessionError if its key is unknown."""
        return _found(self.records, key, "record")

    def model(self, key: str, *, ready: bool = False) -> ModelEntry:
        """Return a model; raise SessionError if its key is unknown or, with `ready`, if the model is not usable."""
        entry = _found(self.models, key, "model")
        if ready and entry.status != "ready":
            raise SessionError(f"{entry.name}: is not ready ({entry.status}); wait until it is, or identify again")
        return entry

    def excite(self, request: Mapping[str, Any]) -> str:
        """Write the excitation from `low` to `high` [V], with `slew` [V/s] and `frequency` [Hz]; return the job."""
        low, high = (number_of(request.get(name), name) for name in ("low", "high"))
        file = self.folder.new(places.EXCITATIONS, f"{low:g}-to-{high:g}-V", ".csv")
        asked = {name: request.get(name) for name in ("low", "high", "slew", "frequency")}
        given = {"base": low, "present": min(max(0.0, low), high), "limits": (low, high), "output": file}
        given |= {"slew_rate": asked["slew"], "frequency": asked["frequency"]}
        entry = ExcitationEntry(self._id("e"), Path(file).stem, file, asked)

        def done(finished: Finished) -> None:
            if finished.result is not None:
                entry.fill(finished.result)
                self.excitations[entry.id] = entry

        return self.jobs.start("excite", "", [words_of("excite recommended", str(high), **given)], done)

    def add_record(self, source: str, name: str) -> RecordEntry:
        """Read a file, `source` relative to the folder, as a record."""
        entry = RecordEntry(self._id("r"), Path(name).stem[:200] or "record", source)
        self.records[entry.id] = entry
        self.read_record(entry.id)
        return entry

    def read_record(self, key: str, columns: str = "") -> None:
        """Read a record's file (again) with a text of columns; only files in the folder are joined."""
        entry = self.record(key)
        if users := [model.name for model in self.models.values() if entry.id in (*model.train, *model.validate)]:
            raise SessionError(f"{entry.name}: {users[0]} was identified from it; upload the file again instead")
        if self.jobs.running(entry.id):
            raise SessionError(f"{entry.name}: is being read; wait until this is done")
        if columns.startswith("@"):
            raise SessionError(f"columns: got {columns[:40]!r}, need a text of columns")
        known = Columns.parse(columns)
        known.demand([key for key in RECORD if key != "join"], "on the page", axes=bool(known.axes))
        if known.axes:
            known.of_axes()
        file = entry.file or self.folder.new(places.RECORDS, entry.name, ".npz")
        # Records are replaced only with --force: here the same file is read with other columns.
        step = [*words_of("show", entry.source, output=file, columns=str(known)), "--force"]
        entry.columns, entry.status, entry.error, entry.hint = str(known), "reading", None, ""
        if is_model(self.folder.path / entry.source):
            entry.status, entry.error = "refused", _NO_RECORD
            self.touch()
            return

        def done(finished: Finished) -> None:
            told = finished.error if finished.result is None else finished.result
            entry.file_columns = told.get("file_columns", [])[:_MOST_COLUMNS] or entry.file_columns
            if finished.result is None:
                # The form has the suggestion already.
                words = str(finished.error.get("reason", finished.words))
                entry.status, entry.error = "refused", words.replace(entry.source, Path(entry.source).name)
                entry.hint = str(finished.error.get("suggestion", ""))
                return
            entry.file = file
            entry.fill(finished.result)

        self.jobs.start("read", entry.id, [step], done)

    def identify(self, request: Mapping[str, Any]) -> ModelEntry:
        """Identify a model from records: `train`, `validate` and `options`."""
        train, validate = (self._usable(request.get(role, ())) for role in ("train", "validate"))
        if not train:
            raise SessionError("train: got no record, need at least one; choose the records to identify from")
        if twice := {record.id for record in train} & {record.id for record in validate}:
            raise SessionError(f"{', '.join(sorted(twice))}: got two roles, need one; choose one for each record")
        if len({tuple(record.axes) for record in (*train, *validate)}) > 1:
            raise SessionError("train: got records of different axes, need the same axes in all records")
        options = request.get("options", {})
        if not isinstance(options, dict):
            raise SessionError("options: need an object with a value for each option")
        given = {name: value for name, value in options.items() if name != "name" and value not in (None, "")}
        if unknown := [name for name in given if name not in _IDENTIFY]:
            raise SessionError(f"options: got {unknown[0]!r}, need some of {', '.join(_IDENTIFY)}")
        file = self.folder.new(places.MODELS, str(options.get("name") or train[0].name), ".json")
        stem = Path(file).stem
        entry = ModelEntry(self._id("m"), stem, file, options=given, report=f"{places.REPORTS}/{stem}.html")
        entry.train, entry.validate = ([record.id for record in role] for role in (train, validate))
        outputs = {"output": file, "report": entry.report, "validate": [record.file for record in validate]}
        step = words_of("identify", *(record.file for record in train), **outputs, **given, **train[0].reading)
        began = time.monotonic()

        def progress(words: str) -> None:
            entry.progress, entry.seconds = words, time.monotonic() - began

        async def done(finished: Finished) -> None:
            entry.seconds, entry.progress = time.monotonic() - began, ""
            if finished.result is not None and (self.folder.path / file).exists():
                # Fill in the ranges before the entry is ready: the page uses the ranges of every ready model.
                await asyncio.to_thread(entry.fill_ranges, self.folder.path / file)
            entry.fill(finished)

        self.jobs.start("identify", entry.id, [step], done, progress)
        self.models[entry.id] = entry
        return entry

    def end(self, key: str) -> None:
        """End an identification: the first call keeps the best model so far, the second call ends it at once."""
        entry = self.model(key)
        if entry.status != "identifying":
            raise SessionError(f"{entry.name}: is not being identified ({entry.status})")
        for job in self.jobs.running(entry.id, "identify"):
            (self.jobs.stop if entry.early else self.jobs.finish)(job)
        entry.early, entry.progress = True, "completing the best model so far"
        self.touch()

    def insight(self, key: str, _: Mapping[str, Any]) -> str:
        """Assess a model on its training records; return the job."""
        entry = self.model(key, ready=True)
        known = [self.records[key] for key in entry.train if key in self.records]
        files, read = [record.file for record in known], known[0].reading if known else {}
        if not files:
            raise SessionError(f"{entry.name}: its training records were deleted; identify again")
        report = self.folder.new(places.REPORTS, f"{Path(entry.file).stem}-insight", ".html")

        def done(finished: Finished) -> None:
            if finished.result is not None:
                entry.insight = {"report": report}

        words = words_of("insight", entry.file, *files, report=report, **read)
        return self.jobs.start("insight", entry.id, [words], done)

    def check(self, key: str, request: Mapping[str, Any]) -> str:
        """Check with a `record` whether a model is still true; return the job."""
        model, record = self.model(key, ready=True), self._usable([request.get("record")])[0]

        def done(finished: Finished) -> None:
            if (found := finished.result) is None:
                return
            parts = found.get("axes", {"": found})
            model.check = {
                "record": record.id,
                "good": found["good"],
                "updates": not any(part["mismatch"] for part in parts.values())
                and any(not part["good"] or part["advises_update"] for part in parts.values()),
                "sentences": [f"{axis}: {own['sentence']}" if axis else own["sentence"] for axis, own in parts.items()],
                "why": [words for part in parts.values() for words in part["change_sentences"]],
                "remarks": [words for part in parts.values() for words in part["remarks"]],
            }
            if model.coupling:
                model.check["why"] += found["changes"]

        return self.jobs.start("check", model.id, [words_of("check", model.file, record.file, **record.reading)], done)

    def update(self, key: str, request: Mapping[str, Any]) -> str:
        """Update a model from a `record`, and list the new one if it is better; return the job."""
        model, record = self.model(key, ready=True), self._usable([request.get("record")])[0]
        file = self.folder.new(places.MODELS, f"{model.name}-updated", ".json")

        def done(finished: Finished) -> None:
            if (found := finished.result) is None:
                return
            parts = found.get("axes", {"": found})
            if not any(part["used"] for part in parts.values()):
                raise SessionError("; ".join(part["sentence"] for part in parts.values()))
            basis, goal = f"parts of {record.name} held out in turn", model.verdict["goal"] if model.verdict else 1.0
            verdicts = {
                axis: verdict_of(part["promise"], "READY" if part["good"] else "USABLE", basis, goal, part["sentences"])
                for axis, part in parts.items()
            }
            self._list_updated(model, file, record.name, verdicts)

        step = words_of("update", model.file, record.file, output=file, **record.reading)
        return self.jobs.start("update", model.id, [step], done)

    def _list_updated(self, model: ModelEntry, file: str, record: str, verdicts: Mapping[str, dict[str, Any]]) -> None:
        """List a model that was updated from a record, with the verdict of each axis."""
        entry = replace(
            model,
            id=self._id("m"),
            name=Path(file).stem,
            file=file,
            origin=f"Updated from {record}. Before: {model.name}. The report is that of the identification.",
            verdict={**worst(verdicts), "remarks": model.verdict["remarks"] if model.verdict else []},
            coupling=model.coupling and {**model.coupling, "verdicts": verdicts},
            seconds=None,
            insight=None,
            check=None,
        )
        entry.fill_ranges(self.folder.path / file)
        self.models[entry.id] = entry
        self.touch()

    def follow(self, key: str, request: Mapping[str, Any]) -> str:
        """Compute the voltage for a path (`scan` or `points`, drawn or of a `file`) with a model; return the job."""
        model, scan = self.model(key, ready=True), request.get("scan")
        kind = scan.get("kind") if isinstance(scan, Mapping) else "path"
        file = self.folder.new(places.VOLTAGES, f"{model.name}-{kind}", ".csv")
        steps = self._path_steps(model, request, file)
        # A file may have many points.
        left_out = "points" if "file" in request else ""
        asked = {name: request[name] for name in _PATH if name in request and name != left_out}
        entry = VoltageEntry(self._id("v"), Path(file).stem, file, model.id, asked)

        def done(finished: Finished) -> None:
            if finished.result is not None:
                entry.fill(finished.result, number_of(request.get("rate"), "rate"))
                self.voltages[entry.id] = entry

        return self.jobs.start("compensate", entry.id, steps, done)

    def export(self, key: str, request: Mapping[str, Any]) -> str:
        """Export a model as a `kind`: c, fmu or wasm, with a `period` [s] or without; return the job."""
        model, kind = self.model(key, ready=True), str(request.get("kind", ""))
        if kind not in EXPORTS:
            raise SessionError(f"kind: got {kind!r}, need {', '.join(EXPORTS)}")
        name, suffix = Path(model.file).stem, EXPORTS[kind][-1]
        target = self.folder.new(places.EXPORTS, name if suffix else f"{name}-c", suffix)
        period = None if request.get("period") is None else number_of(request["period"], "period")

        def done(finished: Finished) -> None:
            if period is None and "period" in finished.error.get("change", ()):
                raise SessionError(f"{model.name}: depends on time; fill in Samples a second (Hz)")

        return self.jobs.start("export", model.id, [words_of("export", model.file, target, period=period)], done)

    def cancel(self, job: str) -> None:
        """End a job without a result."""
        self.jobs.stop(_found(self.jobs.entries, job, "job").id)

    def delete(self, key: str) -> None:
        """Remove a record, a model or a voltage from the list; its files stay in the folder."""
        for kind in _KINDS:
            if key in (entries := getattr(self, kind)):
                for job in self.jobs.running(key):
                    self.jobs.stop(job)
                del entries[key]
                self.touch()
                return
        raise SessionError(f"{key}: does not exist; reload the page")

    async def close(self) -> None:
        """End all jobs and save the state."""
        await self.jobs.close()
        self._save()
        self.folder.close()

    def _path_steps(self, model: ModelEntry, request: Mapping[str, Any], file: str) -> list[list[str]]:
        """Return the operations that compute the voltage of points or of a scan."""
        before, columns, path = [], None, self.folder.new(places.PATHS, Path(file).stem, ".csv")
        if "points" in request:
            written_path(self.folder.path / path, request["points"], request.get("rate"))
        elif isinstance(request.get("scan"), Mapping):
            words, axis = scan_words(request["scan"], sample_rate=request.get("rate"), output=path)
            before = [words]
            columns = f"displacement={axis}_um" if "raster" in words and not model.axes else None
        else:
            raise SessionError("path: got none, need points or a scan")
        limits = tuple(number_of(request[name], name) for name in ("low", "high") if name in request)
        slew = "none" if request.get("slew", "") is None else request.get("slew")
        given = {"limits": limits or None, "slew_rate": slew, "columns": columns}
        return [*before, words_of("compensate", model.file, path, output=file, **given)]

    def _usable(self, keys: object) -> list[RecordEntry]:
        """Return records that are ready; raises SessionError if one is not."""
        if not isinstance(keys, list | tuple):
            raise SessionError("train, validate: need lists of records")
        entries = [self.record(str(key)) for key in keys]
        if refused := [entry for entry in entries if entry.status != "ready"]:
            raise SessionError(f"{refused[0].name}: is not ready ({refused[0].status}); choose another record")
        return entries

    def _id(self, letter: str) -> str:
        self._last += 1
        return f"{letter}{self._last}"

    def touch(self) -> None:
        """Announce a change of the state, and save it soon."""
        self.changed()
        if self._saving is None:
            self._saving = asyncio.get_running_loop().call_later(_SOON, self._save)

    def _entries(self) -> dict[str, Any]:
        return {kind: [asdict(entry) for entry in getattr(self, kind).values()] for kind in _KINDS}

    def _save(self) -> None:
        """Write the entries."""
        if self._saving is not None:
            self._saving.cancel()
            self._saving = None
        self.folder.save(finite({"last": self._last, **self._entries()}))

    def _take_up(self, saved: Mapping[str, Any]) -> None:
        """Continue the session in the folder; jobs that ran when it ended were cancelled."""
        self._last = int(saved.get("last", 0))
        for kind, entry in _KINDS.items():
            setattr(self, kind, _restored(entry, saved.get(kind, ())))
        for record in self.records.values():
            if record.status == "reading":
                record.status, record.error = "refused", "the workbench ended while the record was read; read it again"
        for model in self.models.values():
            if model.status == "identifying":
                model.status, model.error = "cancelled", "the workbench ended during the identification"


def _restored(kind: Callable[..., _T], saved: Any) -> dict[str, _T]:
    """Return entries from a state file; unknown fields are left out."""
    known = {part.name for part in fields(kind)}  # type: ignore[arg-type]
    return {entry["id"]: kind(**{name: value for name, value in entry.items() if name in known}) for entry in saved}


def _found(entries: Mapping[str, _T], key: str, what: str) -> _T:
    if key not in entries:
        raise SessionError(f"{key}: no such {what} exists; reload the page")
    return entries[key]
