"""The data of the page's forms, and paths that are read for it."""

import pytest

from dehyst import Actuator, MaxwellSlip, Spring, Stage
from dehyst.operations.command import NUMBER
from dehyst.operations.registry import find
from dehyst.waveforms.scans import SCANS
from dehyst.workbench.data import RequestError, path_points
from dehyst.workbench.entries import RecordEntry
from dehyst.workbench.forms import FORMS, scan_form, scan_kinds
from dehyst.workbench.reading import columns_of, form_of, verified

ACTUATOR = Actuator(MaxwellSlip([1e-6], [1e6]), Spring([0, 1e-5], [0, 100]), limits=(0, 100))


def test_forms_offer_what_the_operations_declare():
    known = {parameter.name: parameter for parameter in find("identify").params}
    for name, field in FORMS["identify"].items():
        parameter = known.get(name)
        assert field["label"] == name.replace("_", " ").capitalize() or name == "name"
        if parameter is None:
            assert name == "name"
        elif "choices" in field:
            offered = {value for value, _ in field["choices"]}
            assert offered <= {*parameter.type.choices}
            assert field["value"] == parameter.default
        else:
            assert parameter.type is NUMBER


def test_a_scan_has_a_field_for_each_of_its_options():
    fields, kinds = scan_form(), scan_kinds()
    for name, scan in SCANS.items():
        own = [*kinds[name]["needs"], *kinds[name]["may"]]
        assert len(own) == len({*own})
        assert {*scan.takes} <= {*own} <= {*fields}


@pytest.fixture
def points(tmp_path):
    def read(text, model=ACTUATOR):
        model.save(tmp_path / "model.json")
        (tmp_path / "path.csv").write_text(text)
        return path_points(tmp_path / "path.csv", tmp_path / "model.json")

    return read


@pytest.mark.parametrize(
    "text",
    [
        "time_s,displacement_um\n0,1\n0.5,2\n1,1.5\n",
        "# a comment\ntime_ms;weg_nm\n0;1000\n500;2000\n1000;1500\n",
        '"Time [ms]";"Position (um)"\n1000,0;1,0\n1500,0;2,0\n2000,0;1,5\n',
        "0 1\n0.5 2\n1 1.5",
        "voltage_V,time_s,displacement_m\r\n9,0,1e-6\r\n9,0.5,2e-6\r\n9,1,1.5e-6\r\n",
    ],
)
def test_a_path_is_read_from_text(points, text):
    assert points(text) == [[pytest.approx(row) for row in [[0, 1], [0.5, 2], [1, 1.5]]]]


def test_a_path_of_several_axes_is_read_by_their_names(points):
    stage = Stage([ACTUATOR, ACTUATOR], axes=("x", "y"))
    found = points("time_s,y_um,x_um\n0,1,2\n1,3,4\n", stage)
    assert found == [[[0, 2], [1, 4]], [[0, 1], [1, 3]]]
    with pytest.raises(RequestError, match="time_s,x_um,y_um"):
        points("time_s,y_um\n0,1\n1,3\n", stage)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("time,displacement\n0,1\n1,3\n", "time_s,displacement_um"),
        ("a,b\n1,2\n", "time_s,displacement_um"),
        ("time_s,displacement_um\n0,1\n0,2\n", "do not rise"),
        ("time_s,displacement_um\n0,1\n1,x\n", "which is no number"),
        ("time_s,displacement_um\n0,1\n", "two rising times"),
    ],
)
def test_a_text_that_is_no_path_is_refused_with_a_reason(points, text, words):
    with pytest.raises(RequestError, match=words) as refused:
        points(text)
    assert "path.csv" not in str(refused.value)


COLUMNS = [{"name": name, "unit": unit, "range": [0, 1]} for name, unit in (("t", "s"), ("U", "V"), ("s:um", "um"))]
PAIRS = [*COLUMNS, {"name": "V2", "unit": "V", "range": []}, {"name": "y_um", "unit": "um", "range": []}]


def record(table=COLUMNS, **about):
    return RecordEntry("r1", "loops", "uploads/loops.csv", file_columns=table, **about)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "voltage=U:mV, displacement=3:nm, decimal=comma",
        "time=t, voltage=U*100, rate=100",
        "voltage=U, displacement=3:V*fringe 316.4 nm",
    ],
)
def test_an_unchanged_form_gives_the_columns_from_which_it_was_made(text):
    entry = record(columns=text)
    assert columns_of(entry, form_of(entry)["values"]) == text


def test_a_suggestion_is_marked_and_an_accepted_guess_stays_a_guess():
    entry = record(status="refused", hint="voltage=U:V?, displacement=3:um")
    form = form_of(entry)
    assert form["marked"] == ["voltage_1", "displacement_1"] and form["help"]
    assert columns_of(entry, form["values"]) == "voltage=U:V?, displacement=3:um"
    assert columns_of(entry, {**form["values"], "voltage_1_unit": "mV"}).startswith("voltage=U:mV,")
    entry = record(status="refused", hint="time=1:s, displacement=3:um?*GAIN um/V")
    form = form_of(entry)
    assert columns_of(entry, {"displacement_1": "2", "displacement_scale": "2,5 um/V"}) == "displacement=3*2.5 um/V"
    assert (form["values"]["time"], form["values"]["voltage_1"]) == ("0", "")
    assert form["values"]["displacement_scale"] == "GAIN um/V" and "displacement_scale" in form["marked"]


@pytest.mark.parametrize(
    ("columns", "known"),
    [
        ("voltage=U:V?, displacement=3:um*2.5?", "voltage=U:V, displacement=3:um*2.5"),
        ("voltage=U?*15, displacement=3?:um", "voltage=U*15, displacement=3:um"),
        ('x=U?:"a, b?"', 'x=U:"a, b"'),
        ("voltage=is it?here", "voltage=is it?here"),
    ],
)
def test_verified_columns_have_no_marks_of_guesses(columns, known):
    assert verified(columns) == known


def test_columns_of_coupled_axes_are_paired_by_their_units():
    entry = record(PAIRS, status="refused")
    form = form_of(entry)
    assert form["values"]["axes"] == "2" and "pairs" in form["help"]
    text = columns_of(entry, form["values"])
    assert text == "time=t, s=U:3, y=V2:y_um"
    again = form_of(record(PAIRS, columns=text))
    assert {name: again["values"][name] for name in form["pairs"]} == form["pairs"]
    with pytest.raises(RequestError, match="all their columns"):
        columns_of(entry, {**form["values"], "voltage_2": ""})
    with pytest.raises(RequestError, match="letters and digits"):
        columns_of(entry, {**form["values"], "name_2": "1 x"})


def test_a_form_that_contradicts_itself_is_refused():
    alike = record([*COLUMNS[:2], {**COLUMNS[1]}])
    found = columns_of(alike, {"time": "0", "voltage_1": "1", "displacement_1": "2"})
    assert found == "time=t, voltage=2, displacement=3"
    for values, words in (
        ({"voltage_1": "1", "displacement_1": "1"}, "two fields"),
        ({"voltage_1": "9"}, "two fields"),
        ({"voltage_scale": "100"}, "its column"),
        ({"rate": "fast"}, "above 0"),
    ):
        with pytest.raises(RequestError, match=words):
            columns_of(alike, values)
