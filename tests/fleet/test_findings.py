"""What the table of a fleet shows: outliers, reasons, duplicates, ageing, and the prior."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import places
import pytest

import dehyst.fleet.run
from dehyst import FileFormatError, IdentifyError, Record
from dehyst.fleet import FleetOptions, drifts_of, findings_of, identify_fleet, load
from dehyst.fleet.drift import Ageing, chart_of, natural_order
from dehyst.fleet.findings import QUANTITIES
from dehyst.fleet.page import write_fleet_page
from dehyst.fleet.prior import fitted, identified_with_prior, shape_of

pytest.importorskip("pyarrow")
from command_line import run_as_process as run
from fleet_records import columns, inline, write_parquet

pytestmark = pytest.mark.usefixtures("in_this_process")

COUNT, SESSIONS = 32, 4
DEAD, NOISY, DRIFTING, AGEING, COPY = 5, 9, 14, 6, (17, 2)


def change(k):
    """Serial S006 ages; one record each is dead, noisy, drifting and a copy of an earlier one."""
    if k == DEAD:
        return None
    serial, session = divmod(COPY[1] if k == COPY[0] else k, SESSIONS)
    aged = 0.03 * session if serial == AGEING else 0.0
    given = {"gain": (1 + 0.01 * serial) * (1 - aged), "width": 0.5 * (1 + aged)}
    return given | ({"noise": 60e-9} if k == NOISY else {}) | ({"drift": 0.05} if k == DRIFTING else {})


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet")
    path = write_parquet(folder / "d.parquet", COUNT, change, SESSIONS)
    copied = columns(COPY[1], **change(COPY[1]))
    _replace(path, COPY[0], copied)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dehyst.fleet.run, "run_tasks", inline)
        identify_fleet(path, folder / "m.parquet", by=("serial", "session"))
    return folder / "m.parquet"


def _replace(path, number, values):
    """Write another record into one row group."""
    import pyarrow
    import pyarrow.parquet

    file = pyarrow.parquet.ParquetFile(path)
    groups = [file.read_row_group(k) for k in range(file.num_row_groups)]
    for name, column in zip(("time_s", "voltage_V", "displacement_um"), values, strict=True):
        at = groups[number].column_names.index(name)
        groups[number] = groups[number].set_column(at, name, pyarrow.array(column))
    with pyarrow.parquet.ParquetWriter(path, file.schema_arrow) as writer:
        for group in groups:
            writer.write_table(group)


def test_noisy_and_drifting_records_are_listed_and_the_others_are_not(table):
    fleet = load(table)
    found = findings_of(fleet)
    names = [fleet.name(row) for row in fleet.rows]
    assert {names[NOISY], names[DRIFTING]} <= set(found.listed)
    assert {one.quantity.name for one in found.outliers if one.record == names[NOISY]} >= {"noise", "RMS error"}
    healthy = set(names) - {names[NOISY], names[DRIFTING]} - {f"S{AGEING:03d}/{k}" for k in range(SESSIONS)}
    assert not healthy & set(found.listed)


def test_refused_records_have_their_reason_and_duplicates_are_found(table):
    fleet = load(table)
    found = findings_of(fleet)
    assert [names for _, names in found.refused] == [(fleet.name(fleet.rows[DEAD]),)]
    assert "constant but for noise" in found.refused[0][0]
    assert found.duplicates == ((fleet.name(fleet.rows[COPY[1]]), fleet.name(fleet.rows[COPY[0]])),)


def test_reasons_that_differ_in_numbers_only_are_one_and_records_are_counted(table):
    found = load(table)
    reasons = [
        "record 'S000/0': no column 'volts'; the file holds 3 columns",
        "S000/1: no column 'volts'; the file holds 12 columns",
        "S000/2: the time goes back at sample 1.5e3",
    ]
    rows = [
        {**row, "outcome": "refused", "detail": "RecordError", "reason": why}
        for row, why in zip(found.rows, reasons, strict=False)
    ]
    groups = findings_of(replace(found, rows=tuple(rows)))
    assert [names for _, names in groups.refused] == [("S000/0", "S000/1"), ("S000/2",)]
    assert [why for why, _ in groups.refused] == [reasons[0][17:], reasons[2][8:]]
    assert "Without a model (3):" in groups.lines()


def test_a_serial_that_ages_is_to_be_recalibrated(table):
    found = drifts_of(load(table), by="serial", over="session")
    ageing = {one.serial: one for one in found.ageing}
    due = {one.serial for one in found.recalibrate}
    # A record of another actuator, and one that drifted, are in two other serials.
    assert f"S{AGEING:03d}" in due and due <= {f"S{AGEING:03d}", "S004", "S003"}
    one = ageing[f"S{AGEING:03d}"]
    assert np.all(np.diff(one.costs) > 0) and one.chart.outside
    # The truth: 3 % of the stroke a session.
    assert np.allclose(one.signed, [-3.1, -6.4, -9.9], atol=0.5)
    with pytest.raises(FileFormatError, match="column 'batch'"):
        drifts_of(load(table), by="batch", over="session")


def test_scores_are_of_the_side_and_no_score_without_a_distribution():
    noise = next(quantity for quantity in QUANTITIES if quantity.name == "noise")
    values = np.exp(np.random.default_rng(1).normal(0, 0.5, 2001))
    scores, median = noise.scores(np.append(values, [100.0, np.nan]))
    assert abs(median - 1) < 0.05 and abs(np.std(scores[:-2]) - 1) < 0.1
    assert scores[-2] > 5 and scores[-1] == 0
    assert not noise.scores(values[:5])[0].any()


def test_the_page_and_the_commands(table, tmp_path):
    status, text, _ = run("fleet", "report", str(table), "-o", str(tmp_path / "fleet.html"))
    page = (tmp_path / "fleet.html").read_text()
    assert status == 1 and "Look at (" in text and "Same samples (1)" in text
    assert "S002/1" in page and "http" not in page.replace("http-equiv", "")
    status, text, _ = run("fleet", "report", str(table), "--json")
    found = json.loads(text)
    assert status == 1 and found["outcomes"] == {"identified": COUNT - 1, "refused": 1}
    assert f"S{AGEING:03d}" in found["drift"]["recalibrate"]


def test_the_report_says_first_what_to_do_and_has_what_drift_finds(table, tmp_path):
    _, text, _ = run("fleet", "report", str(table), "-o", str(tmp_path / "fleet.html"), "--json")
    assert json.loads(text)["drift"] == drifts_of(load(table), by="serial", over="session").as_dict()
    page = (tmp_path / "fleet.html").read_text()
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", page)
    assert headings[:4] == ["To recalibrate", "To look at", "Without a model", "Same samples"]
    assert f"<title>Fleet of {COUNT} records: m</title>" in page
    assert f"S{AGEING:03d}" in page[: page.index("To look at</h2>")]
    # A table without sessions has no drift, unless it is asked for.
    status, text, _ = run("fleet", "report", str(table), "--over", "stroke", "--json")
    assert status == 2
    status, text, _ = run("fleet", "report", str(table), "--goal", "50", "--json")
    assert status == 0 and json.loads(text)["drift"]["goal_percent"] == 50


def test_dots_are_visible(table, tmp_path):
    write_fleet_page(tmp_path / "a.html", findings_of(load(table)))
    page = (tmp_path / "a.html").read_text()
    data = json.loads(re.search(r'<script type="application/json" id="chart-data">(.*?)</script>', page, re.S)[1])
    dots = [one for chart in data["charts"] for one in chart["series"] if one["kind"] == "points"]
    assert dots and all(one["width"] >= 3 for one in dots)
    widths = {one["name"]: one["width"] for one in dots}
    assert widths["to look at"] > widths["records"]


def test_a_name_cannot_break_the_page(table, tmp_path):
    found = findings_of(load(table))
    write_fleet_page(tmp_path / "a.html", found, command="<script>alert(1)</script>")
    assert "<script>alert" not in (tmp_path / "a.html").read_text()


def test_the_code_of_the_page(table, tmp_path, monkeypatch):
    page = (places.DOCS / "how_to" / "fleet.md").read_text()
    shutil.copy(table, tmp_path / "models.parquet")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(re.search(r"```python\n(.*?)```", page, re.S)[1], names)
    assert 0 < len(names["good"]) < COUNT


def test_other_files_are_no_table(tmp_path):
    path = write_parquet(tmp_path / "d.parquet", 2)
    with pytest.raises(FileFormatError, match="no table of"):
        load(path)


@pytest.fixture(scope="module")
def shape(table):
    return shape_of(load(table))


def record(number, samples=60, **given):
    t, v, y = columns(number, samples=samples, **given)
    return Record(t, v, y * 1e-6, name=f"r{number}")


def test_a_prior_takes_gain_and_width_from_the_record(shape):
    widths = []
    for width in (0.4, 0.6):
        actuator = fitted(record(100, gain=1.3, noise=100e-9, width=width), shape)
        assert abs(np.ptp(actuator.spring.displacement) / 13e-6 - 1) < 0.02
        widths.append(actuator.provenance["width"])
    # The widths of the loops are in proportion to the truths'.
    assert abs(widths[1] / widths[0] - 1.5) < 0.15
    assert shape.actuator(1e-5, 1.0).wide is False


def test_a_prior_is_kept_where_it_predicts_better_only(shape):
    options = FleetOptions().identification
    quiet, row = identified_with_prior(record(100, samples=160), shape, options)
    assert row["prior"] == "not tried" and quiet.actuator.identification.method != "fleet"
    noisy, row = identified_with_prior(record(100, noise=300e-9), shape, options)
    assert row["prior"] == "kept" and row["held_out_prior_percent"] < row["held_out_own_percent"]
    assert noisy.actuator.identification.method == "fleet"


@pytest.mark.parametrize("size", [321, 641])
def test_a_record_of_few_cycles_is_not_refused_for_its_prior(shape, size):
    whole = record(100, samples=320)
    few = whole.slice(0, size)
    assert few.cycles()[-1].stop == size
    fit, row = identified_with_prior(few, shape, FleetOptions().identification)
    assert fit.actuator is not None
    if size == 321:  # one cycle cannot be split
        assert row == {"held_out_own_percent": None, "held_out_prior_percent": None, "prior": "not kept"}


def test_an_error_of_the_comparison_refuses_no_record(shape, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError

    monkeypatch.setattr("dehyst.fleet.prior._folds", fail)
    fit, row = identified_with_prior(record(100, noise=300e-9), shape, FleetOptions().identification)
    assert fit.actuator is not None and row["prior"] == "not kept"


def test_a_dead_actuator_gets_no_prior(shape):
    t, v, y = columns(1)
    dead = Record(t, v, np.random.default_rng(1).normal(0, 2e-9, y.size))
    with pytest.raises(ValueError, match="constant but"):
        identified_with_prior(dead, shape, FleetOptions().identification)


def test_a_run_with_a_prior_names_what_was_kept(table, tmp_path):
    path = write_parquet(tmp_path / "few.parquet", 2, lambda k: {"noise": (2e-9, 300e-9)[k], "samples": 160})
    fleet = identify_fleet(path, tmp_path / "m.parquet", by=("serial", "session"), prior=table, jobs=1)
    assert [row["prior"] for row in fleet.rows] == ["not tried", "kept"]


def test_a_prior_needs_some_models(tmp_path):
    path = write_parquet(tmp_path / "few.parquet", 2)
    identify_fleet(path, tmp_path / "m.parquet", by=("serial", "session"), jobs=1)
    with pytest.raises(IdentifyError, match="has 2 plain models"):
        shape_of(load(tmp_path / "m.parquet"))


def edited(table, path, change):
    """Write a table with `change` applied to its Arrow table, metadata kept."""
    import pyarrow.parquet

    pyarrow.parquet.write_table(change(pyarrow.parquet.read_table(table)), path)
    return load(path)


def with_column(name, change):
    """A change of one column's values."""

    def changed(arrow):
        import pyarrow

        at, values = arrow.column_names.index(name), change(arrow.column(name).to_pylist())
        return arrow.set_column(at, name, pyarrow.array(values))

    return changed


@pytest.mark.parametrize("kind", [int, str])
def test_sessions_have_a_natural_order(table, tmp_path, kind):
    sessions = [kind(number) for number in (1, 10, 11, 2)]
    fleet = edited(table, tmp_path / "m.parquet", with_column("session", lambda old: [sessions[k] for k in old]))
    found = drifts_of(fleet, by="serial", over="session")
    ageing = next(one for one in found.ageing if one.serial == f"S{AGEING:03d}")
    assert ageing.sessions == tuple(map(kind, (1, 2, 10, 11)))
    assert found.as_dict()["oldest"] == kind(1) and found.as_dict()["newest"] == kind(11)


def test_text_with_numbers_has_a_natural_order():
    names = ["s10", "s2", "2026-10", "2026-02", "s2b"]
    _, key = natural_order(names)
    assert sorted(names, key=key) == ["2026-02", "2026-10", "s2", "s2b", "s10"]
    assert sorted(["1.5", "-2", "1e1"], key=natural_order(["1.5", "-2", "1e1"])[1]) == ["-2", "1.5", "1e1"]


def test_an_actuator_out_of_its_limits_is_to_be_recalibrated_below_the_goal(table):
    found = drifts_of(load(table), by="serial", over="session", goal=8.0)
    for one in found.ageing:
        assert one.recalibrate == (one.costs[-1] > 8 or one.outside) == one.as_dict()["recalibrate"]
        assert one.as_dict()["outside"] == one.outside
    due = {one.serial: one for one in found.recalibrate}
    assert due[f"S{AGEING:03d}"].costs[-1] < 8 and "limits since" in due[f"S{AGEING:03d}"].words
    assert any("deviation of 0.8 % (a tenth" in x for x in found.lines())
    status, text, _ = run("fleet", "report", str(table), "--goal", "8", "--json")
    assert status == 1 and set(json.loads(text)["drift"]["recalibrate"]) == set(due)


def test_costs_that_are_low_again_are_not_out_of_limits():
    # Later sessions that cost less than usual, and one bad record long ago.
    for costs in ([5.0, 0.0, 0.0, 0.0], [9.0, 5.0, 5.0, 5.0]):
        chart = chart_of(np.array(costs), 5.0, 0.1)
        one = Ageing("A", (0, 1, 2, 3, 4), np.array(costs), np.zeros(4), chart, 6.0, 5.3, 0.1)
        assert chart.outside and not one.outside and not one.recalibrate


def test_costs_below_what_the_models_are_expected_to_miss_are_no_ageing():
    costs = np.full(4, 0.6)
    chart = chart_of(costs, 0.1, 0.1)
    rough, exact = (Ageing("A", (0, 1, 2, 3, 4), costs, np.zeros(4), chart, 1.0, 0.4, own) for own in (0.65, 0.3))
    assert not rough.recalibrate
    assert exact.recalibrate


def test_models_of_one_session_count_once_and_are_remarked(table, tmp_path):
    fleet = edited(table, tmp_path / "m.parquet", with_column("session", lambda old: [min(k, 2) for k in old]))
    found = drifts_of(fleet, by="serial", over="session")
    ageing = next(one for one in found.ageing if one.serial == f"S{AGEING:03d}")
    assert ageing.sessions == (0, 1, 2) and abs(ageing.signed[-1] + 9.9) < 0.5
    assert "S000/2 (2 models)" in found.remarks[0]
    _, text, errors = run("fleet", "report", str(tmp_path / "m.parquet"), "--json")
    assert "share serial" in errors and json.loads(text)["drift"]["warnings"]
    one = edited(table, tmp_path / "one.parquet", with_column("session", lambda old: [0 for _ in old]))
    with pytest.raises(FileFormatError, match=r"\d+ models share"):
        drifts_of(one, by="serial", over="session")


@pytest.mark.parametrize("name", ["model", "rms_percent", "outcome", "serial"])
def test_a_table_without_a_column_is_refused(table, tmp_path, name):
    with pytest.raises(FileFormatError, match=f"has no column '{name}'"):
        edited(table, tmp_path / "m.parquet", lambda arrow: arrow.drop_columns([name]))


def test_a_column_of_another_kind_is_refused(table, tmp_path):
    with pytest.raises(FileFormatError, match="kind string"):
        edited(table, tmp_path / "m.parquet", with_column("rms_percent", lambda old: [str(x) for x in old]))


@pytest.mark.parametrize("text", ["{", "{}", "[1]", None, '{"format": "dehyst-actuator", "version": 2}'])
def test_a_damaged_model_names_file_and_row(table, tmp_path, text):
    fleet = edited(table, tmp_path / "m.parquet", with_column("model", lambda old: [*old[:3], text, *old[4:]]))
    with pytest.raises(FileFormatError, match=r"row 3 \(S000/3\): the column 'model'"):
        fleet.actuators()


def test_options_of_the_findings_that_are_impossible(table, tmp_path):
    fleet = load(table)
    with pytest.raises(IdentifyError, match="threshold: got nan"):
        findings_of(fleet, threshold=float("nan"))
    with pytest.raises(IdentifyError, match="goal: got nan"):
        drifts_of(fleet, by="serial", over="session", goal=float("nan"))
    with pytest.raises(IdentifyError, match="over: got 'serial', as by"):
        drifts_of(fleet, by="serial", over="serial")
    empty = edited(table, tmp_path / "m.parquet", lambda arrow: arrow.slice(0, 0))
    with pytest.raises(FileFormatError, match="holds no rows"):
        drifts_of(empty, by="serial", over="session")
    with pytest.raises(FileFormatError, match="holds no rows"):
        findings_of(empty)
