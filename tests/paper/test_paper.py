"""The paper redone: run once, then everything that was written is read back."""

import re
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from markup import Page

from dehyst._errors import FileFormatError, MissingExtraError
from dehyst._io import read_json
from dehyst.paper import experiment, tables
from dehyst.paper import run as paper
from dehyst.paper.tables import MODELS
from dehyst.records import largest

NUMBERS = range(3, 13)
FIGURES = [f"fig{n:02d}" for n in NUMBERS]


@pytest.fixture(scope="module")
def result():
    return paper.run()


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    target = tmp_path_factory.mktemp("paper") / "new" / "folder"
    written = paper.write(result, target)
    assert sorted(path.name for path in target.iterdir()) == sorted(path.name for path in written)
    return target


@pytest.fixture(scope="module")
def numbers(folder):
    return read_json(folder / "results.json")


def value(numbers, which, key, column):
    return next(row for row in numbers[which]["summary"] if row["key"] == key)[column]


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "index.html").read_text(encoding="utf-8"))


@pytest.mark.nightly
def test_every_figure_is_there_in_two_formats(folder):
    for name in FIGURES:
        svg = ET.parse(folder / f"{name}.svg").getroot()
        width, height = (float(svg.get(key).removesuffix("pt")) / 72 for key in ("width", "height"))
        assert width == pytest.approx(3.4) or width == pytest.approx(7.0)
        assert height < 6
        png = (folder / f"{name}.png").read_bytes()
        assert png[:8] == b"\x89PNG\r\n\x1a\n" and png[-8:-4] == b"IEND"
        assert int.from_bytes(png[16:20], "big") == pytest.approx(600 * width, abs=1)


def test_the_page_says_the_results(page, numbers):
    rows = [["".join(cell[:1]) for cell in row] for row in page.rows]
    for which, at in (("asymmetric", 0), ("symmetric", 1)):
        for row in numbers[which]["summary"]:
            shown = [cells for cells in rows if cells[:1] == [row["quantity"]]][at]
            digits = 3 if row["unit"] == "µm" else 2
            expected = [row[key] for key in ("actuator", *MODELS)]
            said = ["–" if x is None else f"{x:.{digits}f} {row['unit']}".replace("-", "−") for x in expected]
            assert shown[2:] == said
            assert shown[1] == ("–" if row["paper"] is None else f"{row['paper']:g} {row['unit']}")
    k = [f"{x:.0f}" for x in numbers["asymmetric"]["table1"]["k_N_per_m"]]
    heads = next(i for i, cells in enumerate(rows) if cells[:1] == ["i"])
    assert [cells[2] for cells in rows[heads + 1 : heads + 11]] == k


def test_the_page_stands_alone_and_refers_to_nothing_missing(page, folder):
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert page.tags.count("html") == page.tags.count("main") == page.tags.count("h1") == 1
    assert page.tags.count("svg") == len(FIGURES) == page.tags.count("figcaption")
    ids = [value for _, key, value in page.attributes if key == "id"]
    assert len(ids) == len(set(ids))
    used = set(re.findall(r"url\(#([^)]+)\)", text))
    for tag, key, link in page.attributes:
        if key in ("src", "href", "xlink:href", "srcset", "action"):
            assert link.startswith("#") or (tag == "a" and (folder / link).is_file()), link
            used |= {link[1:]} if link.startswith("#") else set()
        elif not key.startswith("xmlns"):
            assert "//" not in (link or "")
    assert used and used <= set(ids)
    assert not {"script", "link", "iframe", "object", "embed", "base", "img"} & set(page.tags)
    assert "@import" not in text and not re.findall(r"url\((?!#)", text)
    assert "default-src 'none'" in text


def test_the_virtual_actuator_is_what_the_paper_reports(numbers):
    assert value(numbers, "asymmetric", "nominal", "actuator") == pytest.approx(13.63, abs=0.05)
    assert value(numbers, "asymmetric", "range", "actuator") == pytest.approx(16.152, abs=0.005)
    assert value(numbers, "asymmetric", "spacing", "breakpoints") == pytest.approx(1.615, abs=0.001)


def test_the_papers_method_errs_by_its_first_segment(result, numbers):
    """A model through every break point misses a branch by what straight segments between them miss."""
    found = result.symmetric
    time, run = found.runs["relaxed"].record.time, found.runs["relaxed"]
    falling = (time >= 2.5 * 100) & (time <= 3 * 100)
    y, v = run.true[falling], run.record.voltage[falling]
    knots = np.linspace(y[0], y[-1], 11)
    chord = np.interp(v[::-1], np.interp(knots, y[::-1], v[::-1])[::-1], knots[::-1])[::-1]
    missed = 100 * np.abs(chord - y).max() / found.truth.stroke
    for loop in ("major", "medium", "small"):
        assert value(numbers, "symmetric", loop, "breakpoints") == pytest.approx(missed, rel=0.03)


def test_the_whole_record_is_as_good_as_was_asked_where_nothing_is_open_and_the_class_fits(numbers):
    for loop, most in (("major", 0.2), ("medium", 0.3), ("small", 0.3), ("tracking", 0.4)):
        assert value(numbers, "symmetric", loop, "record") < most
    for loop in ("medium", "small"):
        assert value(numbers, "asymmetric", loop, "record") < 0.3
    assert value(numbers, "asymmetric", "major", "record") > 0.2


def test_the_shift_is_that_of_equation_10(result):
    for found in result.experiments.values():
        # By Eq. 10 from measured numbers: minus the reading at t = 0 of a sensor not zeroed again.
        rest = found.runs["relaxed"].zero - found.runs["pre-energised"].zero
        # Two samples set the two zeros in both numbers: what is left is the mean of the noise of two records.
        assert found.shift.mean() == pytest.approx(rest, abs=3e-10)
        assert found.shift.std() == pytest.approx(np.sqrt(2) * found.truth.noise, rel=0.05)
    predicted = result.symmetric.trials["record"].shift
    assert predicted == pytest.approx(result.symmetric.shift.mean(), rel=0.02)


def test_physical_constants_are_the_papers(result):
    p = tables.physical(result.asymmetric)
    keq = 8.82e4 * 1.4e6 / (8.82e4 + 1.4e6)
    assert p.equivalent_stiffness == pytest.approx(keq, rel=1e-12)
    model = result.asymmetric.trials["breakpoints"].actuator
    np.testing.assert_allclose(p.stiffness, model.slip.stiffness * 0.042 * keq / 1.4e6, rtol=1e-12)
    # Eq. 4 at the peak, in newtons: what the carts and the spring hold is T v0, but for the noise of the turning
    # points: 2 nm where the loop rises by 40 nm/V at least.
    assert p.friction.sum() + p.parallel[-1] == pytest.approx(0.042 * 200, abs=0.042 * 2 / 40)
    assert p.nonlinear[-1] < -10


def test_errors_start_at_the_first_peak_and_count_every_loop(result):
    run = result.asymmetric.runs["relaxed"]
    spans = [run.known(loop) for loop in experiment.PEAKS]
    assert [run.record.voltage[span].max() for span in spans] == [200.0, 140.0, 70.0]
    assert run.record.voltage[spans[0].start] == 200.0
    assert spans[-1].stop == len(run.record)
    trial = result.asymmetric.trials["record"]
    worst = 100 * np.abs(trial.simulated[spans[1]] - run.true[spans[1]]).max() / 16.152e-6
    assert trial.errors["medium"] == pytest.approx(worst, rel=1e-12)


def test_tracking_is_what_the_truth_does_with_the_voltage(result):
    found = result.asymmetric
    tracking = found.trials["record"].tracking
    assert (tracking.voltage.min(), tracking.voltage.max()) >= (0.0, 0.0)
    assert tracking.voltage.max() <= 200.0
    truth = experiment.virtual_actuator()
    homing = 100 - 100 * np.cos(2 * np.pi * np.arange(501) / 500)
    truth.play(homing, measured=False)
    reached = truth.play(tracking.voltage, measured=False) - found.runs["relaxed"].zero
    np.testing.assert_allclose(reached, tracking.reached, atol=1e-15)


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_numbers(numbers):
    again = experiment.run(experiment.virtual_actuator(), lambda _: None).trials["breakpoints"]
    found = {**again.errors, "tracking": largest(again.tracking.error)}
    assert found == {key: value(numbers, "asymmetric", key, "breakpoints") for key in found}


@pytest.mark.nightly
def test_the_same_result_is_written_the_same(result, folder, tmp_path):
    paper.write(result, tmp_path)
    for path in folder.iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_a_folder_that_cannot_be_made_is_refused(result, tmp_path):
    (tmp_path / "file").write_text("taken")
    with pytest.raises(FileFormatError, match="is a file"):
        paper.write(result, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "taken"


def test_without_matplotlib_nothing_is_written(monkeypatch, result, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"dehyst\[plot\]"):
        paper.write(result, tmp_path / "new")
    assert list((tmp_path / "new").iterdir()) == []
