"""The `plot` methods: axes in, axes out, nothing global."""

import subprocess
import sys
from dataclasses import replace
from itertools import product

import numpy as np
import plain_records
import pytest
from summaries import PARTS, VOLTS, anatomy

import dehyst
from dehyst import ModelError, RecordError, Structure
from dehyst._errors import MissingExtraError
from dehyst.control import plan_path
from dehyst.model import creep_times, major_loop
from dehyst.report.pages import render

matplotlib = pytest.importorskip("matplotlib")
Figure = pytest.importorskip("matplotlib.figure").Figure

HOSTILE = "_$\\frac{1}$ <b>\n" + "long" * 40
KINDS = {
    "record": ["loop", "time"],
    "actuator": ["loop", "elements"],
    "creeping": ["creep", "loop"],
    "fit": ["loops", "hysteresis", "residuals", "residuals in time"],
    "insight": ["turns", "band"],
    "check": ["hysteresis", "loops", "residuals", "residuals in time"],
}
PICTURES = [(name, kind) for name, kinds in KINDS.items() for kind in kinds]


@pytest.fixture(scope="module")
def things():
    plant = plain_records.plant(6)
    record = plain_records.loops(plant, plain_records.DESCENDING_TOPS, samples=30, noise=5e-9, name=HOSTILE)
    other = plain_records.loops(plant, plain_records.THREE_LOOPS, samples=30, noise=5e-9, name="other")
    fit = dehyst.identify(record, validate=other, structure=Structure(elements=6, knots=7))
    plan = plan_path(dehyst.Compensator(fit.actuator), np.linspace(2e-6, 12e-6, 20))
    insight = dehyst.insight(fit.actuator, record, plan=plan)
    creeping, check = anatomy("creep"), dehyst.check(fit.actuator, record)
    return {
        "record": record,
        "actuator": fit.actuator,
        "creeping": creeping,
        "fit": fit,
        "insight": insight,
        "check": check,
    }


def axes():
    return Figure().subplots()


@pytest.mark.parametrize(("name", "kind"), PICTURES)
def test_plot_uses_the_given_axes_and_changes_no_global_setting(things, name, kind):
    from matplotlib import pyplot

    before, figures = dict(matplotlib.rcParams), pyplot.get_fignums()
    ax = axes()
    assert things[name].plot(kind, ax=ax) is ax
    assert ax.has_data()
    labels = [ax.get_xlabel(), ax.get_ylabel()]
    assert all("(" in label or label == "sample" for label in labels)
    assert ax.get_title()
    ax.figure.canvas.draw()
    assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == figures


def test_with_given_axes_pyplot_is_not_loaded():
    code = (
        "import sys, dehyst, matplotlib.figure as f\n"
        "dehyst.Record([0, 1, 2], [0, 1, 0], [0, 1e-6, 0]).plot('time', ax=f.Figure().subplots())\n"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "False\n"


def test_without_axes_each_plot_makes_a_new_figure(things):
    from matplotlib import pyplot

    backend = matplotlib.get_backend()
    pyplot.switch_backend("agg")
    try:
        first, second = things["record"].plot(), things["record"].plot("time")
        assert first.figure is not second.figure
        assert {first.figure.number, second.figure.number} <= set(pyplot.get_fignums())
    finally:
        pyplot.close(first.figure)
        pyplot.close(second.figure)
        pyplot.switch_backend(backend)


def test_records_are_drawn_in_micrometres(things):
    record = things["record"]
    (line,) = record.plot("loop", ax=axes()).lines
    y = line.get_ydata()
    assert (np.nanmin(y), np.nanmax(y)) == pytest.approx(
        np.array([record.displacement.min(), record.displacement.max()]) * 1e6, rel=1e-3
    )


def test_the_loops_of_an_actuator_lie_within_its_limits(things):
    actuator = things["actuator"]
    lines = actuator.plot(ax=axes()).lines
    for line in lines:
        assert actuator.limits[0] <= line.get_xdata().min()
        assert line.get_xdata().max() <= actuator.limits[1]
    assert np.array(lines[0].get_ydata())[[0, 199]] == pytest.approx(np.array(actuator.reach) * 1e6, rel=1e-6, abs=1e-9)


# Parts of a model, each there or not; the first bends the model, the others let it depend on time.
OPTIONAL = (
    PARTS["graded"] | PARTS["transformer"] | PARTS["smooth"],
    PARTS["creep"],
    PARTS["inertia"] | PARTS["lag"] | PARTS["delay"],
)


@pytest.mark.parametrize("chosen", list(product([False, True], repeat=len(OPTIONAL))))
def test_every_combination_of_parts_is_drawn_and_reported(things, chosen):
    parts = [part for part, taken in zip(OPTIONAL, chosen, strict=True) if taken]
    actuator = replace(anatomy("plain"), **{name: value for part in parts for name, value in part.items()})
    low, high = major_loop(actuator, (0.0, VOLTS))
    for kind in [*KINDS["actuator"], *(["creep"] if creep_times(actuator).size else [])]:
        ax = actuator.plot(kind, ax=axes())
        ax.figure.canvas.draw()
        if kind == "loop":
            drawn = np.array(ax.lines[0].get_ydata())
            assert drawn[[0, 199]] == pytest.approx(1e6 * np.array([low, high]), abs=1e-4)
    assert render(replace(things["fit"], actuator=actuator)).count("data-chart=") > 6


def test_an_impossible_picture_is_refused_before_a_figure_is_made(things):
    from matplotlib import pyplot

    figures = pyplot.get_fignums()
    with pytest.raises(RecordError, match="'loop' or 'time'"):
        things["record"].plot("loops")
    with pytest.raises(ModelError, match="creep"):
        things["actuator"].plot("creep")
    with pytest.raises(ModelError, match="'turns' or 'band'"):
        things["insight"].plot("loops")
    with pytest.raises(ModelError, match="without traces"):
        replace(things["fit"], traces=()).plot()
    assert pyplot.get_fignums() == figures


def test_without_matplotlib_the_error_says_what_to_install(things, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"needs matplotlib.*pip install 'dehyst\[plot\]'"):
        things["record"].plot()
