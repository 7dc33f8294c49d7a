"""Models side by side: figures by hand where they can be, a table of two branches, models of other packages."""

import json
import re
from dataclasses import dataclass, replace

import numpy as np
import plain_records
import pytest
from command_line import run

import dehyst
from dehyst import FileFormatError, IdentifyError, ModelError, Record, RecordError
from dehyst.identification import prepare
from dehyst.identification.regressors import epochs
from dehyst.model import AbstractModel, turned
from dehyst.report import write_report
from dehyst.trust import AbstractBaseline, compare
from dehyst.trust.baselines import Linear, TwoBranches
from dehyst.trust.comparison import OURS, Played, contenders, scored
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

PLANT = plain_records.plant()
LOOPS = plain_records.loops(PLANT, plain_records.THREE_LOOPS, name="three")


@pytest.fixture(scope="module")
def records():
    return [plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="tops"), LOOPS]


def plant(_):
    """The actuator that made the records, as a model of them."""
    return PLANT


def judged(record, held_out, models):
    """Return the rows of models fitted to one record and judged by another."""
    return scored([record], [held_out], models, lambda _: None)[0]


def test_errors_are_those_of_the_residual(records):
    line = Linear(plain_records.STROKE / plain_records.VOLTS)
    row = compare(records[0], validate=records[1], models={"line": lambda _: line}).rows[0]
    score, record = row.scores[0], records[0]
    kept = slice(len(record) - score.samples, None)
    error = 100 * (record.displacement - line.slope * record.voltage)[kept] / plain_records.STROKE
    assert score.largest_without == pytest.approx(np.abs(error).max())
    assert score.rms_without == pytest.approx(np.sqrt(np.mean(error**2)))
    assert score.largest == pytest.approx(np.abs(error - error.mean()).max())
    assert score.rms == pytest.approx(error.std())


def test_samples_before_the_held_out_part_are_played_and_not_compared(records):
    whole, cut = (
        judged(records[0], Played(prepare(records[1]), lead=lead), {"truth": plant})[0].scores[1] for lead in (0, 6.0)
    )
    assert cut.samples < whole.samples
    assert cut.samples == np.count_nonzero(records[1].time >= 6.0)
    assert cut.samples + cut.left_out == len(records[1])
    assert cut.largest_without < 1e-9


def test_dehysts_model_gets_its_state_from_earlier_samples(records):
    """A record that begins in the middle of a motion, but still goes through its range: that tells every cart."""
    middle = records[1][len(records[1]) // 6 :]
    lead = 0.5 * float(np.ptp(middle.time))
    score = judged(records[0], Played(prepare(middle), lead=lead), {"truth": plant})[0].worst("validation")
    assert (score.largest, score.rms) == pytest.approx((0, 0), abs=1e-6)
    assert score.largest_without == pytest.approx(0, abs=1e-6)


@dataclass(frozen=True)
class Stranger(AbstractModel):
    """The plant, as a model of others whose axis lies elsewhere."""

    shift: float

    def simulate(self, voltage, *, state=None, time=None):
        motion = PLANT.simulate(voltage, state=state or turned(PLANT, 0.0, rising=False))
        return replace(motion, displacement=motion.displacement + self.shift)

    def compensate(self, displacement, *, state=None, time=None):
        return PLANT.compensate(np.subtract(displacement, self.shift), state=state)


def test_other_models_get_a_constant_from_earlier_samples(records):
    """Its mean error over the lead's samples that count; without a lead it is told nothing."""
    slope = plain_records.STROKE / plain_records.VOLTS
    chosen = {"shifted": lambda _: Stranger(0.25 * plain_records.STROKE), "line": lambda _: Linear(slope)}
    silent, found = (judged(records[0], Played(prepare(records[1]), lead=lead), chosen) for lead in (0, 6.0))
    before, after = (result[0].worst("validation") for result in (silent, found))
    assert before.largest_without == pytest.approx(25)
    assert after.largest_without == pytest.approx(0, abs=1e-6)
    line = found[1].worst("validation")
    error = 100 * (records[1].displacement - slope * records[1].voltage) / plain_records.STROKE
    first = int(np.argmax(records[1].time >= 6.0))
    lead = slice(epochs(records[1][: first + 1])[-1].start, first + 1)
    assert line.largest_without == pytest.approx(np.abs(error[first:] - error[lead].mean()).max())
    assert line.rms_without == pytest.approx(np.sqrt(np.mean((error[first:] - error[lead].mean()) ** 2)))
    assert line.largest == pytest.approx(np.abs(error[first:] - error[first:].mean()).max())


def test_earlier_samples_without_a_cycle_give_a_constant_by_the_last_one(records):
    """It ends before the voltage has been through its range: what counts begins after that, and no sample before."""
    line = Linear(plain_records.STROKE / plain_records.VOLTS)
    score = judged(records[0], Played(prepare(records[1]), lead=0.3), {"line": lambda _: line})[0].scores[1]
    first = score.left_out
    assert records[1].time[first] > 0.3 + records[1].time[0]
    assert epochs(records[1][: first + 1]) == []
    error = 100 * (records[1].displacement - line.slope * records[1].voltage) / plain_records.STROKE
    assert score.largest_without == pytest.approx(np.abs(error[first:] - error[first]).max())


def test_the_delay_of_a_model_is_subtracted(records):
    time, displacement = records[0].time, records[0].displacement
    late = replace(records[0], displacement=np.interp(time - 0.02, time, displacement))
    both = [
        compare(late, models={"truth": lambda _, lag=lag: dehyst.Actuator(PLANT.slip, PLANT.spring, delay=lag)})
        for lag in (0.0, 0.02)
    ]
    assert both[1].rows[0].scores[0].rms < 0.1 * both[0].rows[0].scores[0].rms


def fails(error):
    def fit(records):
        raise error

    return fit


class Broken(AbstractBaseline):
    """A model whose code fails."""

    state = 0.0

    def _run(self, *_, **__):
        return 5


ERRORS = {
    "refuses": IdentifyError("got no relaxed rise"),
    "breaks": ZeroDivisionError("division by zero"),
    "silent": RuntimeError(),
    "singular": np.linalg.LinAlgError("singular matrix"),
}
OTHERS = {
    "empties": lambda records: (records.clear(), Linear(1e-7))[1],
    "nothing": lambda _: None,
    "a class": lambda _: Linear,
    "broken": lambda _: Broken(),
    "wrong": lambda _: {}["key"],
    **{name: fails(error) for name, error in ERRORS.items()},
}


def test_a_failing_model_affects_only_its_own_row(records):
    comparison = compare(records[0], validate=records[1], models={**OTHERS, "truth": plant})
    found = {row.name: row for row in comparison.rows}
    assert {name for name, row in found.items() if row.failure} == {*OTHERS} - {"empties"}
    assert all(str(error) in found[name].failure for name, error in ERRORS.items())
    assert [len(row.scores) for row in found.values()] == [2, *[0] * 8, 2]
    said = {row["model"]: row["said"] for row in json.loads(json.dumps(comparison.as_dict()))["models"]}
    assert said == {name: row.failure or None for name, row in found.items()}


def test_a_model_without_compared_samples_has_no_score(records):
    (row,) = compare(records[0], models={"late": lambda _: Linear(7.0, delay=1e3)}).rows
    assert row.failure and row.scores == ()


def test_the_last_quarter_is_held_out_by_default(records):
    """No sample of it is seen by a fit; a record whose first three quarters hold no cycle is fitted as a whole."""
    short = plain_records.loops(PLANT, (0, 1, 0, 1), name="short")
    seen = []

    def fit(given):
        seen.extend(given)
        return PLANT

    found = compare([records[0], short], models={"truth": fit, "line": Linear.fit})
    cut = records[0].time[0] + 0.75 * np.ptp(records[0].time)
    assert [record.time[-1] <= cut for record in seen] == [True, True]
    assert len(seen[1]) == len(short)
    assert (found.records, found.held_out, found.apart) == (("tops", "short"), ("tops",), True)
    (score,) = (score for score in found.rows[0].scores if score.role == "validation")
    assert score.samples == np.count_nonzero(records[0].time >= cut)
    assert score.largest_without < 1e-6


def test_the_best_model_has_the_least_error_on_held_out_time(records):
    found = compare(records[0], models={"line": Linear.fit, "truth": plant, "fails": fails(ValueError("no"))})
    errors = {row.name: row.worst("validation").rms for row in found.rows if row.scores}
    best = found.best
    assert (best.model, best.next) == ("truth", "line")
    assert (best.rms, best.next_rms) == (errors["truth"], errors["line"])
    assert best.factor == errors["line"] / errors["truth"]
    assert found.as_dict()["best"]["factor"] == best.factor
    assert compare(records[0], models={"truth": plant}).best is None


def test_the_page_draws_the_models_best_first_and_shows_every_failure(records, tmp_path):
    models = {"line": Linear.fit, "truth": plant, "<b>": fails(ValueError("it <failed>"))}
    found = compare(records[0], validate=records[1], models=models)
    write_report(tmp_path / "page.html", found, command="dehyst compare <x>")
    text = (tmp_path / "page.html").read_text()
    for words in (
        "&lt;b&gt;: ",
        "it &lt;failed&gt;",
        "dehyst compare &lt;x&gt;",
        f"{1e6 * plain_records.STROKE:.1f} µm",
    ):
        assert words in text, words
    assert "://" not in text
    _, bars, _ = text.split("<h2")[:3]
    assert re.findall(r"<dt>(\w+)</dt>", bars) == ["truth", "line"]
    widths = [float(width) for width in re.findall(r"width:([\d.]+)%", bars)]
    assert len(widths) == 4 and max(widths) == 100 and widths[2] > widths[3]
    with pytest.raises(FileFormatError):
        write_report(tmp_path / "none" / "page.html", found)


VOLTS = np.linspace(0, 100, 11)
TABLE = TwoBranches(
    VOLTS, 1e-7 * VOLTS - 1e-8 * VOLTS * (1 - VOLTS / 100), 1e-7 * VOLTS + 1e-8 * VOLTS * (1 - VOLTS / 100)
)


def test_two_branches_follow_the_direction_and_rest_in_between():
    up = TABLE.simulate(VOLTS)
    assert np.array_equal(up.displacement, TABLE.rising)
    down = TABLE.simulate(VOLTS[::-1], state=up.state)
    assert np.array_equal(down.displacement, TABLE.falling[::-1])
    turn = TABLE.simulate([50.0, 49.0, 51.0])
    assert turn.displacement[0] == turn.displacement[1] < turn.displacement[2]


def test_two_branches_are_those_of_the_major_loop():
    plant = plain_records.plant()
    record = plain_records.loops(plant, (0, 1, 0, 1, 0))
    table = TwoBranches.fit(record)
    cycle = slice(len(record) // 2, len(record))
    error = table.simulate(record.voltage).displacement - record.displacement
    error -= error[cycle].mean()
    assert np.abs(error[cycle]).max() < 0.01 * plain_records.STROKE
    line = record.displacement - plain_records.STROKE / plain_records.VOLTS * record.voltage
    assert np.ptp(line[cycle]) > 0.05 * plain_records.STROKE


RISING = np.linspace(0, 1, 400)


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: TwoBranches([0], [0], [0]), ModelError),
        (lambda: TwoBranches([0, 1], [0, 1], [0, 1, 2]), ModelError),
        (lambda: TwoBranches([0, 0], [0, 1], [0, 1]), ModelError),
        (lambda: TwoBranches([0, 1], [1, 0], [1, 2]), ModelError),
        (lambda: TwoBranches([0, 1], [0, 1], [0, 0.5]), ModelError),
        (lambda: TwoBranches([0, 1], [0, 1], [0, np.nan]), ModelError),
        (lambda: TwoBranches.fit([]), IdentifyError),
        (lambda: TwoBranches.fit(Record(RISING, 100 * RISING, 1e-5 * RISING, "rises")), RecordError),
        (lambda: compare((), models={"truth": plant}), IdentifyError),
        (lambda: compare((LOOPS, LOOPS), models={"truth": plant}), IdentifyError),
        # There is no cycle before the last quarter.
        (lambda: compare(plain_records.loops(PLANT, (0, 1, 0, 1)), models={"truth": plant}), IdentifyError),
        (lambda: compare(np.zeros(4), models={"truth": plant}), IdentifyError),
        (lambda: compare(Record([0, 1], [0, 1], [0, 1]), models={"truth": plant}), RecordError),
    ],
)
def test_impossible_arguments_are_refused(make, error):
    with pytest.raises(error):
        make()


FITS = """
from dehyst.trust.baselines import Linear

flat = Linear.fit

def broken(records):
    raise KeyError("slope")
"""
ENTRIES = "flat = rival:flat\nbroken = rival:broken\nabsent = no_such_module:fit\nlinear ratio = rival:broken"


def test_a_model_of_another_package_is_a_row_and_a_faulty_one_fails_alone(tmp_path, monkeypatch):
    information = tmp_path / "rival-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: rival\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[dehyst.baselines]\n{ENTRIES}\n")
    (tmp_path / "rival.py").write_text(FITS)
    monkeypatch.syspath_prepend(tmp_path)
    assert list(contenders())[:3] == [OURS, "two branches", "linear ratio"]
    excitation = descending_tops(100.0, steps=4, drive=Sampling(sample_rate=50.0))
    measured = PlayActuator(highest=100.0).play(excitation.voltage)
    dehyst.write_record(tmp_path / "a.csv", dehyst.Record(excitation.time, excitation.voltage, measured))
    status, out, _ = run("compare", tmp_path / "a.csv", "--json")
    rows = {row["model"]: row for row in json.loads(out)["models"]}
    assert status == 0
    assert rows["flat"]["errors"] == rows["linear ratio"]["errors"] != []
    own = ("flat", "linear ratio", "broken", "absent")
    assert [bool(rows[name]["said"]) for name in own] == [False, False, True, True]
