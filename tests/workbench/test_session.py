"""The session without processes or a browser: what follows from what, with workers that answer as they are told."""

import asyncio
import json

import pytest

from dehyst import Actuator, DehystError, DisplacementCreep, FileFormatError, MaxwellSlip, ModelError, Spring, Thermal
from dehyst.operations.command import context_of, given_in
from dehyst.operations.run import Run, perform
from dehyst.workbench.data import RequestError, wasm, written_path
from dehyst.workbench.entries import ModelEntry, shown
from dehyst.workbench.folder import Folder
from dehyst.workbench.jobs import Finished
from dehyst.workbench.server import Events
from dehyst.workbench.session import SessionError, WorkbenchSession

SHOWN = {
    "samples": 100,
    "duration_s": 1.0,
    "sample_rate_Hz": 99.0,
    "voltage_V": [0, 100],
    "displacement_um": [0, 10],
    "columns": {"voltage": "U", "displacement": "s"},
    "scales": {"voltage": "100 V/V"},
    "others": {"temperature_C": [20.0, 25.0]},
    "usable": True,
    "problems": ["The record is short."],
}
PROMISE = {"largest_percent": 0.5, "rms_percent": 0.1, "largest_m": 5e-8, "apart": "apart from a constant offset"}
VERDICT = {"readiness": "READY", "promise": PROMISE, "basis": "validation records", "goal_percent": 1.0, "reasons": []}
FIT = {"verdict": VERDICT, "remarks": []}


class Told:
    """A worker that waits until it is let go, or is ended."""

    alive = True

    def __init__(self, folder, answer):
        self.answer, self.steps, self.signals = answer, [], []
        self.free = asyncio.Event()

    async def run(self, step, progress):
        self.steps.append(step)
        self.progress = progress
        await self.free.wait()
        self.free.clear()
        return self.answer(step)

    def finish(self):
        self.signals.append("finish")
        self.free.set()

    def stop(self):
        self.signals.append("stop")
        self.alive, self.answer = False, lambda _: Finished(stopped=True)
        self.free.set()

    async def close(self):
        self.alive = False


class Stage:
    """A session whose workers are told what to answer."""

    def __init__(self, path):
        self.workers, self.changes = [], 0
        self.session = WorkbenchSession(Folder(path), self.changed, self.worker)

    def changed(self):
        self.changes += 1

    def worker(self, folder):
        made = Told(folder, lambda _: Finished(SHOWN))
        self.workers.append(made)
        return made

    @property
    def step(self):
        """The words of the last step."""
        return self.workers[-1].steps[-1]

    @property
    def given(self):
        """Its values."""
        return given_in(context_of(self.step))

    async def next(self, *answers):
        """Let the last worker end its steps, with these answers."""
        given = list(answers)
        while self.session.jobs._tasks:
            await asyncio.sleep(0)
            worker = self.workers[-1]
            if given:
                answer = given.pop(0)
                worker.answer = lambda _, answer=answer: answer
            worker.free.set()
            await asyncio.sleep(0.001)
        await self.settled()

    async def settled(self):
        """Wait until no job runs."""
        while tasks := tuple(self.session.jobs._tasks):
            await asyncio.gather(*tasks, return_exceptions=True)

    async def record(self, name="loops.csv"):
        entry = self.session.add_record(f"uploads/{name}", name)
        await self.next(Finished(SHOWN))
        return entry

    async def model(self, answer, **request):
        record = await self.record()
        entry = self.session.identify({"train": [record.id], **request})
        await self.next(answer)
        return entry


@pytest.fixture
def folder(tmp_path):
    made = Folder(tmp_path / "bench")
    yield made
    made.close()


def played(steps):
    """Run the steps of a test in an event loop of their own."""

    def test(tmp_path):
        async def run():
            stage = Stage(tmp_path / "bench")
            try:
                await steps(stage)
            finally:
                for worker in stage.workers:
                    worker.free.set()
                await stage.session.close()

        asyncio.run(run())

    test.__name__, test.__doc__ = steps.__name__, steps.__doc__
    return test


@played
async def test_a_ready_record_states_how_it_was_understood(stage):
    entry = await stage.record()
    assert (entry.status, entry.samples, entry.voltage) == ("ready", 100, [0, 100])
    assert entry.words == ["voltage from 'U', 100 V/V", "displacement from 's'"]
    assert (entry.problems, entry.usable) == (["The record is short."], True)
    assert entry.others == {"temperature_C": [20.0, 25.0]}
    assert stage.session.state()["log"] == ["dehyst show uploads/loops.csv --output records/loops.npz --force"]
    assert stage.changes > 1


@played
async def test_an_excitation_keeps_the_limits_and_is_listed(stage):
    stage.session.excite({"low": -20, "high": 100, "slew": 300, "frequency": None})
    assert stage.session.jobs.entries
    await asyncio.sleep(0)
    written = {"samples": 9, "seconds": 8.0, "lowest_V": -20.0, "highest_V": 100.0, "warnings": ["slow"]}
    await stage.next(Finished(written))
    (entry,) = stage.session.excitations.values()
    assert (entry.range_v, entry.seconds, entry.words) == ([-20.0, 100.0], 8.0, ["slow"])
    assert entry.asked == {"low": -20, "high": 100, "slew": 300, "frequency": None}
    given = stage.given
    assert (given["limits"], given["base"], given["present"], given["slew_rate"]) == ((-20.0, 100.0), -20.0, 0.0, 300)
    with pytest.raises(RequestError):
        stage.session.excite({"low": "0", "high": 1})


@played
async def test_a_refused_table_has_a_reason_and_its_columns_and_no_path_of_the_folder(stage):
    entry = stage.session.add_record("uploads/a.csv", "a.csv")
    columns = [{"name": "U", "unit": "", "range": [0, 1]}, {"name": "s", "unit": "um", "range": []}]
    tried = {"file_columns": columns, "suggestion": "voltage=U:V"}
    await stage.next(Finished(error={"message": "uploads/a.csv: no voltage", **tried}))
    assert (entry.status, entry.error, entry.file_columns) == ("refused", "a.csv: no voltage", columns)
    assert entry.hint == "voltage=U:V"
    assert (stage.session.state()["jobs"][0]["status"], stage.session.state()["log"]) == ("failed", [])
    stage.session.read_record(entry.id, "voltage=U:kg")
    await stage.next(Finished(error={"message": "the unit 'kg' is unknown"}))
    assert (entry.status, entry.file_columns) == ("refused", columns)
    stage.session.read_record(entry.id, "voltage=U:V")
    await stage.next(Finished({**SHOWN, "file_columns": columns}))
    assert (entry.status, entry.error, entry.columns, entry.file_columns) == ("ready", None, "voltage=U:V", columns)


def test_the_page_computes_with_a_model_that_depends_on_temperature(tmp_path):
    Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100]), limits=(0, 100), thermal=Thermal(3e-3)).save(
        tmp_path / "m.json"
    )
    assert wasm(tmp_path / "m.json", None).startswith(b"\0asm")


@played
async def test_a_model_file_is_refused_as_a_record(stage):
    Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100])).save(stage.session.folder.path / "uploads" / "m.json")
    entry = stage.session.add_record("uploads/m.json", "m.json")
    assert entry.status == "refused" and "is a model" in entry.error
    assert stage.session.state()["jobs"] == []


@played
async def test_a_training_record_cannot_be_read_differently(stage):
    entry = await stage.model(Finished(error={"message": "no loop"}))
    assert (entry.status, entry.error) == ("failed", "no loop")
    with pytest.raises(SessionError, match="upload"):
        stage.session.read_record(entry.train[0], "time=t")


@played
async def test_a_model_is_not_ready_before_its_ranges_are_known(stage):
    seen = []

    def fill_ranges(entry, _):
        seen.append(entry.status)
        entry.range_v, entry.range_um = [0.0, 100.0], [0.0, 10.0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ModelEntry, "fill_ranges", fill_ranges)
        record = await stage.record()
        entry = stage.session.identify({"train": [record.id]})
        (stage.session.folder.path / entry.file).write_text("{}")
        await stage.next(Finished(FIT))
    assert seen == ["identifying"]
    assert (entry.status, entry.range_v, entry.range_um) == ("ready", [0.0, 100.0], [0.0, 10.0])


@played
async def test_the_first_end_keeps_the_best_model_and_the_second_stops(stage):
    record = await stage.record()
    entry = stage.session.identify({"train": [record.id]})
    await asyncio.sleep(0.01)
    worker = stage.workers[-1]
    worker.finish = lambda: worker.signals.append("finish")
    stage.session.end(entry.id)
    assert (worker.signals, entry.status, entry.early) == (["finish"], "identifying", True)
    stage.session.end(entry.id)
    await stage.settled()
    assert (worker.signals, entry.status) == (["finish", "stop"], "cancelled")
    with pytest.raises(SessionError, match="identified"):
        stage.session.end(entry.id)


@played
async def test_two_jobs_run_at_a_time_in_kept_workers_and_a_waiting_one_can_be_cancelled(stage):
    for name in ("a.csv", "b.csv", "c.csv"):
        stage.session.add_record(f"uploads/{name}", name)
    await asyncio.sleep(0.01)
    jobs = list(stage.session.jobs.entries.values())
    assert [job.progress for job in jobs] == ["", "", "waiting for its turn"]
    stage.session.cancel(jobs[2].id)
    for worker in stage.workers:
        worker.free.set()
    await stage.settled()
    assert [job.status for job in jobs] == ["done", "done", "cancelled"]
    assert [record.status for record in stage.session.records.values()] == ["ready", "ready", "refused"]
    assert len(stage.session.state()["log"]) == len(stage.workers) == 2
    await stage.record("d.csv")
    assert len(stage.workers) == 2


@played
async def test_an_export_has_the_given_period_and_a_missing_period_names_its_field(stage):
    entry = await stage.model(Finished(FIT))
    stage.session.export(entry.id, {"kind": "c", "period": 0.002})
    await stage.next(Finished({}))
    assert stage.given["period"] == 0.002
    file, creep = stage.session.folder.path / entry.file, DisplacementCreep([1.0], [0.01])
    Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 100]), displacement_creep=creep, limits=(0, 100)).save(file)
    entry.fill_ranges(file)
    assert entry.timed
    stage.session.export(entry.id, {"kind": "fmu"})
    with pytest.raises(ModelError, match="period") as refused:
        perform(context_of(["export", str(file), str(file.with_name("x.fmu"))]), Run())
    await stage.next(Finished(error=refused.value.as_dict()))
    assert "fill in Samples a second (Hz)" in stage.session.state()["jobs"][-1]["error"]
    with pytest.raises(RequestError, match="a number"):
        stage.session.export(entry.id, {"kind": "c", "period": "fast"})


@played
async def test_a_refused_operation_does_not_begin(stage):
    entry = await stage.model(Finished(FIT))
    before = len(stage.session.jobs.entries)
    for request in (
        {"scan": {"kind": "rm"}},
        {"scan": {"kind": "triangle", "low": "1; rm"}},
        {"scan": {"kind": "triangle", "low": True}},
        {"scan": {"kind": "triangle", "rising": "--force"}},
        {"scan": {"kind": "steps", "levels": ["a"]}},
        {"scan": "triangle"},
        {"scan": {"kind": "triangle", "low": 10**400}},
        {"points": [[0, 1], [1, 2]], "rate": 10, "low": 0, "high": "b"},
        {"points": [[0, 1], [1, 2]], "rate": 10, "slew": "fast"},
        {},
    ):
        with pytest.raises(DehystError):
            stage.session.follow(entry.id, request)
    for train in ([], ["r99"], "r1"):
        with pytest.raises(SessionError):
            stage.session.identify({"train": train})
    with pytest.raises(SessionError, match=entry.train[0]):
        stage.session.identify({"train": entry.train, "validate": entry.train})
    for options in ({"structure": "--force"}, {"goal": "1; rm"}, {"output": "x"}, {"shell": "rm"}):
        with pytest.raises(DehystError):
            stage.session.identify({"train": entry.train, "options": options})
    record = stage.session.add_record("uploads/b.csv", "b.csv")
    await stage.next(Finished(SHOWN))
    for columns in ("voltage", "output=x", "rate=fast", "join=../secret.csv", "@secret.txt"):
        with pytest.raises(DehystError):
            stage.session.read_record(record.id, columns)
    assert len(stage.session.jobs.entries) == before + 1


@played
async def test_a_record_of_several_axes_is_identified_and_followed(stage):
    second = {**SHOWN, "voltage_V": [-5, 120], "usable": False, "problems": ["short"]}
    columns = [{"name": "vx", "unit": "V", "range": [0, 100]}]
    parts = {"file_columns": columns, "axes": {"x": {**SHOWN, "problems": []}, "y": second}}
    entry = stage.session.add_record("uploads/two.csv", "two.csv")
    await stage.next(Finished(parts))
    assert (entry.status, entry.axes, entry.voltage) == ("ready", ["x", "y"], [-5, 120])
    assert (entry.problems, entry.usable, entry.file_columns) == (["y: short"], False, columns)
    model = stage.session.identify({"train": [entry.id]})
    worse = {**FIT, "verdict": {**VERDICT, "promise": {**PROMISE, "largest_percent": 2.0}}, "remarks": ["look"]}
    fits = {"x": FIT, "y": worse}
    whole = {"verdict": "Ready for use: ...", "good": True, "coupling": [[1, 0.1], [0, 1]]}
    await stage.next(Finished({**whole, "fits": fits}))
    assert str(stage.given["columns"]) == "x=vx_V:x_m, y=vy_V:y_m"
    assert (model.status, model.verdict["largest_percent"]) == ("ready", 2.0)
    assert model.verdict["remarks"] == ["y: look"]
    assert model.coupling["matrix"][0][1] == 0.1
    assert [verdict["largest_percent"] for verdict in model.coupling["verdicts"].values()] == [0.5, 2.0]
    points = {"x": [[0, 1], [1, 2]], "y": [[0, 3], [2, 1]]}
    stage.session.follow(model.id, {"points": points, "file": "p.csv", "rate": 10, "slew": None})
    pairs = {key: {"x": 0, "y": 5} for key in ("clamped", "lowest_V", "highest_V", "homing_samples", "seconds")}
    promises = {"x": None, "y": {**PROMISE, "largest_percent": 0.7}}
    more = {"homing_s": {"x": 0, "y": 1}, "samples": 9, "warnings": ["a", "b"]}
    await stage.next(Finished({**pairs, **more, "promise": promises}))
    (voltage,) = stage.session.voltages.values()
    assert (voltage.asked, voltage.words[1:]) == ({"file": "p.csv", "rate": 10, "slew": None}, ["a", "b"])
    assert voltage.promises == [None, {**shown(PROMISE), "largest_percent": 0.7}]
    header = (stage.session.folder.path / stage.given["trajectory"]).read_text().splitlines()
    assert header[0] == "time_s,x_um,y_um" and len(header) == 22
    with pytest.raises(SessionError, match="different axes"):
        stage.session.identify({"train": [entry.id, (await stage.record()).id]})


@played
async def test_deleting_an_entry_ends_its_jobs(stage):
    entry = stage.session.add_record("uploads/a.csv", "a.csv")
    await asyncio.sleep(0.01)
    stage.session.delete(entry.id)
    await stage.settled()
    assert stage.workers[-1].signals == ["stop"]
    assert stage.session.state()["records"] == []
    with pytest.raises(SessionError, match="does not exist"):
        stage.session.delete(entry.id)


CHECK = {
    "sentence": "Recalibrate: ...",
    "good": False,
    "advises_update": True,
    "mismatch": "",
    "change_sentences": ["Less."],
    "remarks": [],
}


@played
async def test_an_old_model_is_checked_by_a_new_record_and_updated_from_it(stage):
    model = await stage.model(Finished(FIT))
    record = await stage.record("later.csv")
    with pytest.raises(SessionError, match="no such record"):
        stage.session.check(model.id, {})
    stage.session.check(model.id, {"record": record.id})
    await stage.next(Finished(CHECK))
    assert stage.step == ["check", model.file, record.file]
    assert (model.check["record"], model.check["good"], model.check["why"]) == (record.id, False, ["Less."])
    late = {**PROMISE, "largest_m": 4e-8, "apart": "apart from a constant offset and a delay"}
    numbers = {"good": True, "promise": late, "sentences": ["Less."]}
    stage.session.update(model.id, {"record": record.id})
    await stage.next(Finished({"used": False, "sentence": "Not updated: ...", **numbers}))
    assert list(stage.session.jobs.entries.values())[-1].error == "Not updated: ..."
    stage.session.update(model.id, {"record": record.id})
    await asyncio.sleep(0.01)
    Actuator(MaxwellSlip([1e-6], [1e6]), Spring([0, 1e-5], [0, 100]), limits=(0, 100)).save(
        stage.session.folder.path / stage.given["output"]
    )
    await stage.next(Finished({"used": True, "sentence": "Updated: ...", **numbers}))
    made = list(stage.session.models.values())[-1]
    assert (made.status, made.verdict["readiness"], made.verdict["apart"]) == ("ready", "READY", late["apart"])
    assert made.verdict["largest_um"] == pytest.approx(0.04)
    assert (made.check, made.range_v, made.report) == (None, [0.0, 100.0], model.report)
    assert model.name in made.origin


@played
async def test_jobs_that_ran_when_a_workbench_ended_are_cancelled(stage):
    record = await stage.record()
    stage.session.add_record("uploads/b.csv", "b.csv")
    stage.session.identify({"train": [record.id]})
    stage.session._save()
    again = WorkbenchSession(stage.session.folder, stage.changed, stage.worker)
    state = again.state()
    assert [entry["status"] for entry in state["records"]] == ["ready", "refused"]
    assert [entry["status"] for entry in state["models"]] == ["cancelled"]
    known = {entry["id"] for kind in ("records", "models") for entry in state[kind]}
    assert again.add_record("uploads/c.csv", "c.csv").id not in known


@pytest.mark.parametrize(
    "damage", [{"records": [{"id": 3}]}, {"models": "x"}, {"last": "x"}, {"voltages": [None]}, {"records": 5}], ids=str
)
def test_a_damaged_state_is_refused_with_its_name(folder, damage):
    state = {"format": "dehyst-workbench", "version": 1, **damage}
    (folder.path / "workbench.json").write_text(json.dumps(state))
    with pytest.raises(FileFormatError, match="damaged"):
        WorkbenchSession(folder)


NO_NUMBERS = [[0, 1], [1, float("nan")]], "abc", [[0, "x"], [1, 2]]
NO_PATHS = [], [[0, 1]], [[0, 1], [0, 2], [1, 3]], [[0, 1, 2], [1, 2, 3]]
NO_RATES = ([[0, 1], [1, 2]], 0), ([[0, 1], [1, 2]], None), ([[0, 1], [1e9, 2]], 1e6)


@pytest.mark.parametrize(("points", "rate"), [*((points, 1e3) for points in NO_NUMBERS + NO_PATHS), *NO_RATES], ids=str)
def test_points_that_make_no_path_are_refused(tmp_path, points, rate):
    with pytest.raises(RequestError):
        written_path(tmp_path / "path.csv", points, rate)
    assert not (tmp_path / "path.csv").exists()


def test_uploaded_names_stay_in_the_folder_and_replace_no_file(folder):
    for name in ("../../x", ".", "a/b", "\0", "x" * 1000, "my stage (2)"):
        place = folder.new("models", name, ".json")
        assert place.startswith("models/")
        assert (folder.path / place).resolve().parent == folder.path / "models"
        (folder.path / place).write_text("{}")
        assert folder.new("models", name, ".json") != place
    with pytest.raises(FileFormatError):
        folder.inside("models/../workbench.json")
    names = [folder.new("uploads", "loops", suffix) for suffix in (".csv", ".csv", ".c\nv", "./x", ".")]
    assert names == [f"uploads/{name}" for name in ("loops.csv", "loops-2.csv", "loops", "loops-2", "loops-3")]


def test_a_slow_page_gets_only_the_newest_state():
    async def run():
        states = iter(range(100))
        events = Events(lambda: {"revision": next(states)})
        page = events.page()
        first = await anext(page)
        for _ in range(20):
            events.changed()
            await asyncio.sleep(0.06)
        rest = []
        with pytest.raises(TimeoutError):
            while True:
                rest.append(json.loads(await asyncio.wait_for(anext(page), 1)))
        assert json.loads(first)["revision"] == 0
        assert [state["revision"] for state in rest] == [1]

    asyncio.run(run())


def test_an_incomplete_upload_leaves_no_file(folder):
    with pytest.raises(RuntimeError), folder.receive("uploads/a.csv") as upload:
        upload.write(b"half")
        raise RuntimeError
    assert list((folder.path / "uploads").iterdir()) == []
