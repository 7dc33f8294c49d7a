import base64
import hashlib
import html
import re
import sys

import numpy as np
import pytest
from markup import Page

from dehyst._errors import FileFormatError
from dehyst.identification import Fit, Readiness, RecordErrors, Trace
from dehyst.identification.expectation import Expectation
from dehyst.model import Actuator, MaxwellSlip, Outcome, Promise, Spring
from dehyst.report import pages, sections
from dehyst.report.charts import broken
from dehyst.report.html import spelled

HOSTILE = "<script>alert(\"1\")</script> & 'x' $\\frac{1}$ " + "long_" * 60
# Charts of slip elements, and of where records turned.
MODEL, TURNS = 1, 1


def charts(page):
    """The numbers of the charts, in the order of their places."""
    return [value for _, key, value in page.attributes if key == "data-chart"]


def actuator(name="stage", elements=3):
    slip = MaxwellSlip(np.arange(1, elements + 1) * 2e-6, np.linspace(2e5, 0, elements, endpoint=False))
    return Actuator(slip, Spring([-110e-6, -105e-6, -98e-6, -90e-6], [0, 6, 11, 20]), limits=(0, 20), name=name)


def trace(model, name="major", role="training", samples=600, seed=1):
    time = np.arange(samples) * 1e-3
    voltage = 10 - 10 * np.cos(2 * np.pi * 3 * time / time[-1])
    simulated = model.simulate(voltage).displacement
    noise = np.random.default_rng(seed).normal(0, 2e-8, samples)
    return Trace(name, role, time, voltage, simulated + noise, simulated)


def errors(t, left_out=7):
    largest, rms = np.abs(t.residual).max(), t.residual.std()
    return RecordErrors(
        t.record, t.role, t.time.size, left_out, largest, rms, largest, 2 * rms, 20e-6, 0.1, 1e-6, 3e-7, largest, rms
    )


def promised(percent=0.5):
    """What is promised of a model that misses paths by a percentage of the stroke."""
    largest = percent * 1e-7
    promise = Promise("any path", 0.3 * largest, largest, {"model": largest}, np.full(1, largest), 1e-5, 0.0)
    return Expectation(promise, percent * 3e-8, 1e-9, 1.0, "validation records")


def fit_of(*traces, model=None, outcome=Outcome.IDENTIFIED, **kwargs):
    return Fit(model or actuator(), outcome, promised(), tuple(errors(t) for t in traces), traces=traces, **kwargs)


@pytest.fixture(scope="module")
def fit():
    model = actuator()
    options = {
        "program": "dehyst 9.8.7",
        "lag_of": "sensor",
        "delay_s": 0.0125,
        "stroke_m": 20e-6,
        "records": [{"name": "major", "source": "major.csv", "sha256": "ab" * 32}, {"name": "no file"}],
    }
    return fit_of(
        trace(model),
        trace(model, "minor", "validation", seed=2),
        model=model,
        options=options,
        repairs=("major: shifted by 3 um", "a gap was bridged"),
        remarks=("few minor loops",),
    )


@pytest.fixture(scope="module")
def text(fit):
    return pages.render(fit, "dehyst identify 'a b.csv' > out && echo")


def test_the_page_has_all_sections_in_order(text):
    page = Page(text)
    # Before and after; a loop and two residuals a record.
    assert charts(page) == [str(i) for i in range(1 + 2 * 3 + TURNS + MODEL)]
    # Headline, before and after, and residuals in time are in sight; one fold holds the rest.
    sight, _, rest = text.partition("<summary>All that was found</summary>")
    assert "Residuals in time" in sight and "<details" not in sight.rpartition("<details>")[0] and "Loops, m" in rest


def test_the_page_requests_nothing_from_outside(text):
    page = Page(text)
    page.assert_alone(text)
    # A script, named by its hash, and its data; nothing may be evaluated.
    said = [value for tag, _, value in page.attributes if tag == "script"]
    assert said == ["application/json", "chart-data", "module"]
    (source,) = re.findall(r'<script type="module">(.*?)</script>', text, re.S)
    digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'\"" in text
    assert re.search(r"^(import|export) ", source, re.M) is None


@pytest.mark.parametrize(
    ("percent", "readiness", "colour"),
    [(0.5, Readiness.READY, "green"), (3.0, Readiness.USABLE, "amber"), (6.0, Readiness.NOT_USABLE, "red")],
)
@pytest.mark.parametrize("outcome", Outcome)
def test_the_colour_follows_the_verdict(outcome, percent, readiness, colour):
    expected = promised(percent)
    text = pages.render(Fit(actuator(), outcome, expected))
    assert expected.readiness is readiness
    assert re.findall(r'class="outcome (\w+)"', text) == [colour]
    words = Page(text).words
    assert f"{readiness.value.capitalize()}{percent:g} % of the stroke or " in words
    assert "largest error" in words
    assert (spelled(outcome.value) in words) == (outcome is not Outcome.IDENTIFIED)


def test_hostile_names_are_escaped():
    model = actuator(HOSTILE)
    t = trace(model, HOSTILE, HOSTILE)
    options = {HOSTILE: HOSTILE, "records": [{"name": HOSTILE, "source": HOSTILE}], "more": {"a": [HOSTILE]}}
    fit = fit_of(t, model=model, repairs=(HOSTILE,), remarks=(HOSTILE,), options=options)
    text = pages.render(fit, HOSTILE)
    page = Page(text)
    # The page's own: data, with no mark that could end them, and a script.
    assert text.count("<script") == text.count("</script>") == 2
    assert page.words.count(HOSTILE.strip()) >= 5
    assert html.escape(HOSTILE) in text


def test_the_same_fit_gives_the_same_text_without_matplotlib(monkeypatch, fit, text):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert pages.render(fit, "dehyst identify 'a b.csv' > out && echo") == text


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("elements", [1, 2, 40])
@pytest.mark.parametrize("size", [0, 1, 2, 50])
def test_a_report_of_a_small_fit_is_written(elements, size):
    model = actuator(elements=elements)
    whole = trace(model, samples=600)
    short = Trace("x", "training", *(z[:size] for z in (whole.time, whole.voltage, whole.measured, whole.simulated)))
    fit = Fit(model, Outcome.UNDETERMINED, promised(), traces=(short,))
    page = Page(pages.render(fit))
    assert len(charts(page)) == MODEL + (4 if size > 1 else 0) + (TURNS if size > 2 else 0)


def test_a_report_with_zero_stiffnesses_and_zero_residuals_is_written():
    model = Actuator(MaxwellSlip([1e-7, 2e-7], [0, 0]), Spring([0, 5e-7], [0, 5]))
    voltage = np.linspace(0, 5, 50)
    y = model.simulate(voltage).displacement
    t = Trace("exact", "training", np.arange(50.0), voltage, y, y)
    text = pages.render(Fit(model, Outcome.IDENTIFIED, promised(), traces=(t,)))
    assert '"displacement (nm)"' in text and '"breakaway elongation (nm)"' in text


def test_at_most_a_fixed_number_of_records_is_drawn():
    model = actuator()
    traces = [trace(model, f"record {i}", samples=100) for i in range(8)]
    page = Page(pages.render(fit_of(*traces, model=model)))
    assert len(charts(page)) == 1 + 3 * sections.MOST_RECORDS + TURNS + MODEL
    assert "The first 6 of 8 records" in page.words
    assert "record 7" in page.words


@pytest.mark.parametrize(("samples", "records"), [(8000, 2), (500_000, 8)])
def test_the_size_of_a_report_is_bounded(samples, records):
    model = actuator()
    traces = [trace(model, f"{i}", samples=samples, seed=i) for i in range(records)]
    assert len(pages.render(fit_of(*traces, model=model)).encode()) < 120e3


def test_a_line_is_broken_where_samples_are_missing():
    t = np.array([0.0, 1, 2, 3, 50, 51, 52])
    assert np.isnan(broken(t, 2 * t)).tolist() == [False] * 3 + [True] + [False] * 3


def test_write_report_replaces_a_file(tmp_path, fit, text):
    path = tmp_path / "report.html"
    path.write_text("old")
    pages.write_report(path, fit, command="dehyst identify 'a b.csv' > out && echo")
    assert path.read_text(encoding="utf-8") == text
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(FileFormatError):
        pages.write_report(tmp_path / "none" / "report.html", fit)
