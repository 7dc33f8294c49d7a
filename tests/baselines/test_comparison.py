"""Models side by side: the same figures for each, by hand where they can be; a failure is a row."""

import json
import re
from dataclasses import dataclass, replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import FileFormatError, Fit, IdentifyError, ModelError, Outcome, Record, RecordError
from dehyst.baselines import BASELINES, AbstractBaseline, ModelComparison, compare
from dehyst.baselines.comparison import OURS, ModelScore, contenders, parameters_of, speeds
from dehyst.baselines.linear import Linear
from dehyst.baselines.tracking_trials import TRIALS, TrackingTrial
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.model import AbstractModel
from dehyst.report import write_comparison
from dehyst.report.comparison_section import comparison_sections
from dehyst.report.report import render

PLANT = plain_records.plant()


@pytest.fixture(scope="module")
def records():
    return [
        plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="tops"),
        plain_records.loops(PLANT, plain_records.THREE_LOOPS, name="three"),
    ]


def plant(_):
    """The actuator that made the records, as a model of them."""
    return PLANT


def test_what_made_the_records_misses_nothing_and_ours_finds_it(records):
    chosen = {"truth": plant, OURS: contenders()[OURS]}
    found = compare(records[0], validate=records[1], models=chosen)
    assert [row.name for row in found.rows] == ["truth", OURS]
    assert found.stroke == pytest.approx(plain_records.STROKE)
    for row in found.rows:
        assert [(s.record, s.role) for s in row.scores] == [("tops", "training"), ("three", "validation")]
        assert row.failure == ""
        assert min(row.seconds, row.simulate, row.compensate) > 0
    assert found.rows[0].worst("validation").largest_without < 1e-9
    score, promised = found.rows[1].worst("validation"), found.rows[1].promised
    assert score.largest < 0.5
    assert (score.largest < promised[0], score.rms < promised[1]) == (True, True)


def test_one_rule_promises_for_a_model_that_promises_nothing(records):
    line = Linear(plain_records.STROKE / plain_records.VOLTS)
    (row,) = compare(records[0], validate=records[1], models={"line": lambda _: line}).rows
    trained = row.worst("training")
    assert row.promised[0] >= trained.largest
    assert row.promised[1] > trained.rms
    assert row.as_dict()["promised_percent"] == list(row.promised)
    assert compare(records[0], models={"line": lambda _: line}).rows[0].promised is None


def test_a_constant_is_free_in_one_pair_of_figures_and_not_in_the_other(records):
    shifted = Record(
        records[1].time, records[1].voltage, records[1].displacement + 0.25 * plain_records.STROKE, "moved"
    )
    row = compare(records[0], validate=shifted, models={"truth": plant}).rows[0]
    score = row.worst("validation")
    assert (score.largest, score.rms) == pytest.approx((0, 0), abs=1e-9)
    assert (score.largest_without, score.rms_without) == pytest.approx((25, 25))


def test_figures_are_those_of_the_residual_by_hand(records):
    line = Linear(plain_records.STROKE / plain_records.VOLTS)
    row = compare(records[0], models={"line": lambda _: line}).rows[0]
    score, record = row.scores[0], records[0]
    kept = slice(len(record) - score.samples, None)
    error = 100 * (record.displacement - line.slope * record.voltage)[kept] / plain_records.STROKE
    assert score.largest_without == pytest.approx(np.abs(error).max())
    assert score.rms_without == pytest.approx(np.sqrt(np.mean(error**2)))
    assert score.largest == pytest.approx(np.abs(error - error.mean()).max())
    assert score.rms == pytest.approx(error.std())
    assert row.worst("validation") is None
    assert row.parameters == 2


def test_the_lead_is_played_and_not_counted(records):
    whole, cut = (
        compare(records[0], validate=records[1], lead=lead, models={"truth": plant}).rows[0].scores[1]
        for lead in (0, 6.0)
    )
    assert cut.samples < whole.samples
    assert cut.samples == np.count_nonzero(records[1].time >= 6.0)
    assert cut.samples + cut.left_out == len(records[1])
    assert cut.largest_without < 1e-9


def test_the_lead_tells_ours_where_it_began(records):
    """A record that begins in the middle of a motion, but still goes through its range: that tells every cart."""
    middle = records[1].slice(len(records[1]) // 6, len(records[1]))
    lead = 0.5 * float(np.ptp(middle.time))
    score = compare(records[0], validate=middle, lead=lead, models={"truth": plant}).rows[0].worst("validation")
    assert (score.largest, score.rms) == pytest.approx((0, 0), abs=1e-6)
    assert score.largest_without == pytest.approx(0, abs=1e-6)


@dataclass(frozen=True)
class Stranger(AbstractModel):
    """The plant, as a model of others whose axis lies elsewhere."""

    shift: float

    def simulate(self, voltage, *, state=None, time=None):
        motion = PLANT.simulate(voltage, state=state or PLANT.turned(0.0, rising=False))
        return replace(motion, displacement=motion.displacement + self.shift)

    def compensate(self, displacement, *, state=None, time=None):
        return PLANT.compensate(np.subtract(displacement, self.shift), state=state)


def test_the_lead_tells_any_other_model_a_constant(records):
    """Its mean error over the lead's samples that count; without a lead it is told nothing."""
    chosen = {
        "shifted": lambda _: Stranger(0.25 * plain_records.STROKE),
        "line": lambda _: Linear(plain_records.STROKE / plain_records.VOLTS),
    }
    silent, found = (compare(records[0], validate=records[1], lead=lead, models=chosen) for lead in (0, 6.0))
    before, after = (one.rows[0].worst("validation") for one in (silent, found))
    assert before.largest_without == pytest.approx(25)
    assert after.largest_without == pytest.approx(0, abs=1e-6)
    line = found.rows[1].worst("validation")
    error = (
        100
        * (records[1].displacement - plain_records.STROKE / plain_records.VOLTS * records[1].voltage)
        / plain_records.STROKE
    )
    first = int(np.argmax(records[1].time >= 6.0))
    lead = slice(epochs(records[1].slice(0, first + 1))[-1].start, first + 1)
    assert line.largest_without == pytest.approx(np.abs(error[first:] - error[lead].mean()).max())
    assert line.rms_without == pytest.approx(np.sqrt(np.mean((error[first:] - error[lead].mean()) ** 2)))
    assert line.largest == pytest.approx(np.abs(error[first:] - error[first:].mean()).max())


def test_a_lead_without_a_cycle_tells_by_its_last_sample(records):
    """It ends before the voltage has been through its range: what counts begins after that, and no sample before."""
    line = Linear(plain_records.STROKE / plain_records.VOLTS)
    score = compare(records[0], validate=records[1], lead=0.3, models={"line": lambda _: line}).rows[0].scores[1]
    first = score.left_out
    assert records[1].time[first] > 0.3 + records[1].time[0]
    assert epochs(records[1].slice(0, first + 1)) == []
    error = 100 * (records[1].displacement - line.slope * records[1].voltage) / plain_records.STROKE
    assert score.largest_without == pytest.approx(np.abs(error[first:] - error[first]).max())


def test_the_note_states_what_each_model_uses(records):
    noted, silent = (compare(records[0], validate=records[1], lead=lead, models={"truth": plant}) for lead in (6.0, 0))
    assert noted.note == (
        "The first 6 s of held-out records do not count. From the displacement measured there, the models of dehyst "
        "take their state and an offset of the voltage, every other model takes a constant: its mean error there."
    )
    assert (noted.as_dict()["lead_s"], noted.as_dict()["note"]) == (6.0, noted.note)
    assert noted.note in "".join(comparison_sections(noted))
    assert silent.note == compare(records[0], lead=6.0, models={"truth": plant}).note == ""


def test_the_delay_of_a_model_is_taken_off(records):
    late = Record(
        records[0].time,
        records[0].voltage,
        np.interp(records[0].time - 0.02, records[0].time, records[0].displacement),
        "late",
    )
    both = [
        compare(late, models={"truth": lambda _, lag=lag: dehyst.Actuator(PLANT.slip, PLANT.spring, delay=lag)})
        for lag in (0.0, 0.02)
    ]
    assert both[1].rows[0].scores[0].rms < 0.1 * both[0].rows[0].scores[0].rms


def fails(error):
    def fit(records):
        raise error

    return fit


def test_a_baseline_that_fails_gets_a_row_with_its_sentence(records):
    errors = {
        "refuses": IdentifyError("got no relaxed rise"),
        "breaks": ZeroDivisionError("division by zero"),
        "silent": RuntimeError(),
        "singular": np.linalg.LinAlgError("singular matrix"),
    }
    found = compare(records[0], models={**{name: fails(error) for name, error in errors.items()}, "truth": plant})
    assert [row.failure for row in found.rows] == [
        "got no relaxed rise",
        "division by zero",
        "RuntimeError",
        "singular matrix",
        "",
    ]
    assert all(row.scores == () and row.simulate is None for row in found.rows[:-1])
    assert json.loads(json.dumps(found.as_dict()))["models"][1]["said"] == "division by zero"


class Broken(AbstractBaseline):
    """A model whose code fails."""

    state = 0.0

    def _run(self, *_, **__):
        return 5


OTHERS = {
    "empties": lambda records: (records.clear(), Linear(1e-7))[1],
    "nothing": lambda _: None,
    "a class": lambda _: Linear,
    "broken": lambda _: Broken(),
    "wrong": lambda _: {}["key"],
}


def test_models_of_others_fail_in_their_own_rows_only(records):
    chosen = {**OTHERS, "truth": plant}
    found = {row.name: row for row in compare(records, validate=records[1], models=chosen).rows}
    assert {name for name, row in found.items() if row.failure} == {"nothing", "a class", "broken", "wrong"}
    assert "returned a NoneType" in found["nothing"].failure
    assert found["wrong"].failure.startswith("KeyError")
    assert [len(row.scores) for row in (found["empties"], found["truth"])] == [3, 3]


@dataclass(frozen=True)
class Late(Linear):
    """A model with a delay longer than any record."""

    delay: float = 1000.0


def test_a_model_of_which_no_sample_counts_has_no_score(records):
    (row,) = compare(records[0], models={"late": lambda _: Late(7.0)}).rows
    assert row.failure and row.scores == ()


def test_refusals(records):
    chosen = {"truth": plant}
    for arguments, options, error, said in (
        ((), {}, IdentifyError, "neither records nor a virtual actuator"),
        ((), {"validate": records[1], "truths": ["play"]}, IdentifyError, "no training records"),
        ((records,), {"lead": -1}, IdentifyError, "lead: got -1"),
        ((records,), {"validate": records[1], "lead": 1e6}, IdentifyError, "three: no sample counts after 1e"),
        ((records,), {"truths": ["glass"]}, ModelError, "truths: got 'glass', need one of play, creep"),
        ((np.zeros(4),), {}, IdentifyError, "need records"),
        ((Record([0, 1], [0, 1], [0, 1]),), {}, RecordError, "samples"),
    ):
        with pytest.raises(error, match=said):
            compare(*arguments, models=chosen, **options)


def test_every_baseline_has_an_entry_that_takes_records():
    assert next(iter(contenders())) == OURS
    assert {"Preisach", "Bouc-Wen", "Duhem", "linear ratio", "Goldfarb-Celanovic"} <= set(BASELINES)
    tops = TRIALS["play"].records()[:1]
    for name in ("Duhem", "linear ratio", "Goldfarb-Celanovic"):
        assert parameters_of(BASELINES[name](tops)) > 0


def test_speeds_are_nanoseconds():
    simulate, compensate = speeds(PLANT, Record(np.arange(50) / 10, np.linspace(0, 100, 50), np.linspace(0, 1e-5, 50)))
    assert 0.5 < simulate < 1e4
    assert 0.5 < compensate < 1e4


@dataclass
class Ruler:
    """An actuator without hysteresis that is asked for nothing else."""

    stroke: float = 1e-5
    highest: float = 50.0

    def relax(self):
        """Nothing to forget."""

    def play(self, voltage, *, time=None, measured=True):
        assert time is None or np.all(np.diff(time) > 0)
        return 2e-7 * np.asarray(voltage)


def test_tracking_is_exact_where_the_model_is():
    ruler = TrackingTrial("ruler", lambda seed: Ruler(), 0.01, 0.05, 5.0)
    found = ruler.track(Linear(2e-7))
    assert found == pytest.approx((0, 0, 0), abs=1e-10)
    worse = ruler.track(Linear(2.5e-7))
    assert worse.largest == pytest.approx(20 * ruler.path().max(), rel=1e-9)
    assert worse.beyond == 0
    assert [record.name for record in ruler.records()] == ["ruler-0a", "ruler-0b", "ruler-0c"]


@pytest.mark.parametrize("name", list(TRIALS))
def test_the_path_has_forty_reversals_within_the_stroke(name):
    trial = TRIALS[name]
    path = trial.path(3)
    steps = np.sign(np.diff(path))
    steps = steps[steps != 0]
    assert np.count_nonzero(np.diff(steps)) == 40
    assert path[0] == 0
    assert path.min() == 0
    assert 0.8 < path.max() <= 0.98
    np.testing.assert_array_equal(path, trial.path(3))
    assert not np.array_equal(path[:50], trial.path(4)[:50]) or path.size != trial.path(4).size


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "most"), [("Preisach", 0.4), ("Bouc-Wen", 5.0), ("Duhem", 6.0)])
def test_baselines_track_a_play_actuator_better_than_no_model(name, most):
    found = compare(truths=["play"], models={name: BASELINES[name], "linear ratio": BASELINES["linear ratio"]})
    model, line = (row.tracking["play"] for row in found.rows)
    assert model.largest < most < line.largest
    assert model.rms < 0.5 * line.rms
    assert found.records == ("play-0a", "play-0b", "play-0c")


def table_of(name="a <b>"):
    score = compare(plain_records.loops(PLANT, plain_records.THREE_LOOPS, name="three"), models={name: plant}).rows[0]
    return ModelComparison((score, ModelScore("broken", "it <failed>")), 1e-5, ("three",), (), ("play",))


def test_the_page_shows_every_model_and_what_failed(tmp_path):
    found = table_of()
    write_comparison(tmp_path / "page.html", found, command="dehyst compare <x>")
    text = (tmp_path / "page.html").read_text()
    for words in ("a &lt;b&gt;", "broken: it &lt;failed&gt;", "Tracking, play", "dehyst compare &lt;x&gt;", "10.0 µm"):
        assert words in text, words
    assert "://" not in text
    with pytest.raises(FileFormatError):
        write_comparison(tmp_path / "none" / "page.html", found)


def test_the_page_draws_the_models_best_first_and_marks_the_best(records):
    found = compare(records[0], validate=records[1], models={"line": Linear.fit, "truth": plant})
    bars, table, *_ = comparison_sections(found)
    assert re.findall(r"<dt>(\w+)</dt>", bars) == ["truth", "line"]
    widths = [float(width) for width in re.findall(r"width:([\d.]+)%", bars)]
    assert len(widths) == 4 and max(widths) == 100 and widths[2] > widths[3]
    rows = re.findall(r"<tr>.*?</tr>", table, re.S)
    assert [row.count('class="best"') for row in rows] == [0, 0, 3]


def test_the_report_takes_the_section():
    fit = Fit(None, Outcome.FAILED)
    found = table_of("ours")
    text = re.sub(r' id="part-\d+"', "", render(fit, comparison=found))
    assert all(part in text for part in comparison_sections(found))
    assert "Models compared" not in render(fit)
