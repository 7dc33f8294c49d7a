"""The session of a workbench: what is there, what can be done with it, and what is being done.

It knows neither HTTP nor a browser. Everything is done by commands of dehyst, each in a process of its own, and noted
in the folder's script.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from dehyst._errors import DehystError, FileFormatError
from dehyst._io import finite, write_json
from dehyst._version import __version__
from dehyst.workbench import folder as places
from dehyst.workbench.entries import ModelEntry, RecordEntry, VoltageEntry, restored
from dehyst.workbench.folder import Folder
from dehyst.workbench.jobs import (
    CommandRun,
    Finished,
    Jobs,
    Runner,
    fill_model,
    fill_ranges,
    fill_record,
    fill_voltage,
)
from dehyst.workbench.requests import export_words, identify_words, path_words, read_words, written_path

_T = TypeVar("_T")
# Seconds after a change until it is on the disk.
_SOON = 0.5
# Columns of a file from which the page offers to choose.
_MOST_COLUMNS = 500


class SessionError(DehystError, ValueError):
    """A request that the session cannot fulfil: what was got, what is needed."""


class WorkbenchSession:
    """A workbench without its page.

    Parameters
    ----------
    folder : Folder
    changed : callable
        Called after each change of the state.
    runner : callable
        Makes the command that is run; for tests.
    """

    def __init__(self, folder: Folder, changed: Callable[[], None] = lambda: None, runner: Runner = CommandRun) -> None:
        self.folder, self.revision = folder, 0
        self.records: dict[str, RecordEntry] = {}
        self.models: dict[str, ModelEntry] = {}
        self.voltages: dict[str, VoltageEntry] = {}
        self.changed, self._last = changed, 0
        self._saved: dict[str, Any] = {}
        self._saving: asyncio.TimerHandle | None = None
        self.jobs = Jobs(folder, self.touch, runner)
        self._restore()

    def state(self) -> dict[str, Any]:
        """Return what the page shows, as JSON values."""
        state: dict[str, Any] = finite(
            {
                "revision": self.revision,
                "folder": self.folder.path.name,
                "version": __version__,
                **self._entries(),
                "jobs": [asdict(one) for one in self.jobs.entries.values()],
                "files": list(self.folder.files()),
                "log": self.folder.commands(),
            }
        )
        return state

    def record(self, key: str) -> RecordEntry:
        """Return a record; raises SessionError if there is none."""
        return _found(self.records, key, "record")

    def model(self, key: str, *, ready: bool = False) -> ModelEntry:
        """Return a model, with `ready` one that can be used; raises SessionError if there is none."""
        entry = _found(self.models, key, "model")
        if ready and entry.status != "ready":
            raise SessionError(f"{entry.name}: is not ready ({entry.status}); wait until it is, or identify again")
        return entry

    def voltage(self, key: str) -> VoltageEntry:
        """Return a voltage; raises SessionError if there is none."""
        return _found(self.voltages, key, "voltage")

    def add_record(self, source: str, name: str) -> RecordEntry:
        """Read an uploaded file, `source` relative to the folder, as a record."""
        entry = RecordEntry(self._id("r"), Path(name).stem[:200] or "record", source)
        self.records[entry.id] = entry
        self.read_record(entry.id, {})
        return entry

    def read_record(self, key: str, options: Mapping[str, Any]) -> None:
        """Read a record's file, again if need be, with options of its columns."""
        entry = self.record(key)
        self._demand_unused(entry)
        file = entry.file or self.folder.new(places.RECORDS, entry.name, ".npz")
        words = read_words(entry.source, file, options)
        entry.options, entry.status, entry.error, entry.hint = dict(options), "reading", None, None

        def done(finished: Finished) -> None:
            # With names for all columns the result has these, not the file's.
            columns = () if options.get("columns") else (finished.result or {}).get("file_columns", ())
            entry.columns = [one["name"] for one in columns[:_MOST_COLUMNS]] or entry.columns
            if finished.result is None or finished.status != 0:
                entry.status, entry.error = "refused", finished.error.replace(entry.source, Path(entry.source).name)
                hint = finished.refused.get("suggestion")
                entry.hint = {"options": hint} if hint else None
                return
            entry.file = file
            fill_record(entry, finished.result)

        self.jobs.start("read", entry.id, words, done)

    def identify(self, request: Mapping[str, Any]) -> ModelEntry:
        """Identify a model from records: `train`, `validate` and `options`."""
        train, validate = (self._usable(request.get(role, ())) for role in ("train", "validate"))
        if not train:
            raise SessionError("train: got no record, need one at least; choose the records to identify from")
        if twice := {one.id for one in train} & {one.id for one in validate}:
            raise SessionError(f"{', '.join(sorted(twice))}: to train and to validate; choose one for each record")
        options = request.get("options", {})
        if not isinstance(options, dict):
            raise SessionError("options: need an object with a value for each option")
        options = dict(options)
        name = str(options.pop("name", None) or train[0].name)
        file = self.folder.new(places.MODELS, name, ".json")
        stem = Path(file).stem
        entry = ModelEntry(self._id("m"), stem, file, [one.id for one in train], [one.id for one in validate])
        entry.options, entry.report = options, f"{places.REPORTS}/{stem}.html"
        words = identify_words(entry, [one.file for one in train], [one.file for one in validate])
        self.models[entry.id] = entry
        began = time.monotonic()

        def progress(line: str) -> None:
            entry.progress, entry.seconds = line, time.monotonic() - began
            entry.provisional = (self.folder.path / file).exists()

        async def done(finished: Finished) -> None:
            entry.seconds, entry.progress, entry.provisional = time.monotonic() - began, "", False
            if finished.result is not None:
                write_json(self.folder.path / entry.fit, finished.result)
            if finished.result is not None and finished.result.get("verdict") is not None:
                # Before the entry is ready: a page uses the ranges of every model that is.
                await asyncio.to_thread(fill_ranges, entry, self.folder.path / file)
            fill_model(entry, finished)

        self.jobs.start("identify", entry.id, words, done, progress)
        return entry

    def add_calibrated(self, place: str, result: Mapping[str, Any]) -> ModelEntry:
        """List the model of a calibration in the folder `place`; `result` is what its calibration.json holds."""
        rig = f"{result['rig']}, axis {result['axis']}"
        entry = ModelEntry(self._id("m"), Path(place).name, f"{place}/model.json", rig=rig, seconds=None)
        entry.report = f"{place}/report.html"
        write_json(self.folder.path / entry.fit, result["fit"])
        fill_model(entry, Finished(0, result["fit"]))
        fill_ranges(entry, self.folder.path / entry.file)
        self.models[entry.id] = entry
        self.touch()
        return entry

    def end(self, key: str) -> None:
        """End an identification: first with the best model so far, the second time at once."""
        entry = self.model(key)
        if entry.status != "identifying":
            raise SessionError(f"{entry.name}: is not being identified ({entry.status})")
        for job in self.jobs.running(entry.id, "identify"):
            (self.jobs.stop if entry.early else self.jobs.finish)(job)
        entry.early, entry.progress = True, "completing the best model so far"
        self.touch()

    def insight(self, key: str) -> str:
        """Assess a model on its training records; return the job."""
        entry = self.model(key, ready=True)
        records = [self.record(one).file for one in entry.train if one in self.records]
        if entry.rig:
            played = (one["record"] for one in entry.table if one["role"] == "training")
            records = [f"{Path(entry.file).parent.as_posix()}/records/{name}.h5" for name in played]
        if not records:
            raise SessionError(f"{entry.name}: its training records were deleted; identify again")

        report = self.folder.new(places.REPORTS, f"{Path(entry.file).stem}-insight", ".html")

        def done(finished: Finished) -> None:
            if finished.result is not None:
                entry.insight = {"report": report}

        words = ["insight", entry.file, *records, "--report", report, "--json"]
        return self.jobs.start("insight", entry.id, words, done)

    def follow(self, key: str, request: Mapping[str, Any]) -> str:
        """Compute the voltage for a path with a model: `points`, `scan` or `record`; return the job."""
        model = self.model(key, ready=True)
        name = str(request.get("name") or model.name)
        file = self.folder.new(places.VOLTAGES, name, ".csv")
        path = self._path_of(request, Path(file).stem)
        words = path_words(model.file, file, request, path)
        entry = VoltageEntry(self._id("v"), Path(file).stem, file, model.id)

        def done(finished: Finished) -> None:
            if finished.result is not None:
                fill_voltage(entry, finished, self.folder.path / file)
                self.voltages[entry.id] = entry

        return self.jobs.start("compensate", entry.id, words, done)

    def export(self, key: str, kind: str, request: Mapping[str, Any]) -> str:
        """Export a model as `kind`; return the job."""
        model = self.model(key, ready=True)
        return self.jobs.start("export", model.id, export_words(self.folder, model, kind, request), lambda _: None)

    def cancel(self, job: str) -> None:
        """End a job without a result."""
        self.jobs.stop(_found(self.jobs.entries, job, "job").id)

    def delete(self, key: str) -> None:
        """Take a record, a model or a voltage from the list; its files stay in the folder."""
        for entries in (self.records, self.models, self.voltages):
            if key in entries:
                for job in self.jobs.running(key):
                    self.jobs.stop(job)
                del entries[key]
                self.touch()
                return
        raise SessionError(f"{key}: there is none; reload the page")

    async def close(self) -> None:
        """End all commands and save the state."""
        await self.jobs.close()
        self._save()
        self.folder.close()

    def _path_of(self, request: Mapping[str, Any], name: str) -> str | None:
        """Return the file of a path: a record's, or a new one with the points; None for a scan."""
        if "record" in request:
            return self.record(str(request["record"])).source
        if "points" not in request:
            return None
        file = self.folder.new(places.PATHS, name, ".csv")
        written_path(self.folder.path / file, request["points"], request.get("rate"))
        return file

    def _usable(self, keys: object) -> list[RecordEntry]:
        """Return records that are ready; raises SessionError if one is not."""
        if not isinstance(keys, list | tuple):
            raise SessionError("train, validate: need lists of records")
        entries = [self.record(str(key)) for key in keys]
        if refused := [one for one in entries if one.status != "ready"]:
            raise SessionError(f"{refused[0].name}: is not ready ({refused[0].status}); choose another record")
        return entries

    def _demand_unused(self, entry: RecordEntry) -> None:
        users = [one.name for one in self.models.values() if entry.id in (*one.train, *one.validate)]
        if users:
            raise SessionError(f"{entry.name}: {users[0]} was identified from it; upload the file again instead")
        if self.jobs.running(entry.id):
            raise SessionError(f"{entry.name}: is being read; wait until that is done")

    def _id(self, letter: str) -> str:
        self._last += 1
        return f"{letter}{self._last}"

    def touch(self) -> None:
        """Announce a change, and save it soon."""
        self.revision += 1
        self.changed()
        if self._saving is None:
            self._saving = asyncio.get_running_loop().call_later(_SOON, self._save)

    def _entries(self) -> dict[str, Any]:
        return {
            "records": [asdict(one) for one in self.records.values()],
            "models": [asdict(one) for one in self.models.values()],
            "voltages": [asdict(one) for one in self.voltages.values()],
        }

    def _save(self) -> None:
        """Write the entries if they changed; the progress of an identification is no change."""
        if self._saving is not None:
            self._saving.cancel()
            self._saving = None
        state: dict[str, Any] = finite({"last": self._last, **self._entries()})
        for model in state["models"]:
            if model["status"] == "identifying":
                model |= {"progress": "", "seconds": 0.0}
        if state != self._saved:
            self.folder.save(state)
            self._saved = state

    def _restore(self) -> None:
        """Take up the session that the folder holds; what ran when it ended was cancelled."""
        saved = self.folder.saved()
        try:
            self._take_up(saved)
        except (TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                f"{self.folder.path / places.STATE}: is damaged ({error}); move it elsewhere, or give another folder"
            ) from error

    def _take_up(self, saved: Mapping[str, Any]) -> None:
        self._last = int(saved.get("last", 0))
        for kept in saved.get("records", ()):
            record = restored(RecordEntry, kept)
            if record.status == "reading":
                record.status, record.error = "refused", "the workbench ended while it was read; read it again"
            self.records[record.id] = record
        for kept in saved.get("models", ()):
            model = restored(ModelEntry, kept)
            if model.status == "identifying":
                model.status, model.error = "cancelled", "the workbench ended during the identification"
            self.models[model.id] = model
        for kept in saved.get("voltages", ()):
            voltage = restored(VoltageEntry, kept)
            self.voltages[voltage.id] = voltage


def _found(entries: Mapping[str, _T], key: str, what: str) -> _T:
    if key not in entries:
        raise SessionError(f"{key}: there is no such {what}; reload the page")
    return entries[key]
