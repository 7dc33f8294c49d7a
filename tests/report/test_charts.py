"""Charts: the data that stand in a page are those of the records."""

import base64
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dehyst.report.charts import Axis, Chart, ChartData, Series, stems, vertices


def chart(*series, **kwargs):
    return Chart("a", Axis("voltage", "V"), Axis("error", "nm"), series, role="training", **kwargs)


def columns(data):
    """What the page's script makes of the stored columns."""
    for stored in json.loads(data.json())["columns"]:
        codes = np.frombuffer(base64.b64decode(stored["steps"]), "<u2")
        yield np.where(codes == 65535, np.nan, stored["low"] + stored["step"] * codes)


def test_values_are_stored_to_a_65_000th_of_their_range():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=200), 1e-3 * rng.normal(size=200)
    y[[3, 77]] = np.nan
    data = ChartData()
    assert not data
    assert data.add(chart(Series("one", x, y, "measured"))) == 0
    for values, stored in zip((x, y), columns(data), strict=True):
        assert (np.isnan(values) == np.isnan(stored)).all()
        assert np.nanmax(np.abs(values - stored)) <= 0.51 * np.nanmax(np.ptp(values[~np.isnan(values)])) / 65534


@given(st.integers(0, 99), st.sampled_from([0.0, 1e-3, 0.3]), st.integers(300, 60_000))
@settings(max_examples=40, deadline=None)
def test_a_thinned_line_has_the_same_picture(seed, noise, size):
    """A smooth line stays within a pixel of its samples; of a loud one the extremes of each part stay."""
    rng, most = np.random.default_rng(seed), 600
    x = np.linspace(0, 1, size)
    y = 0.4 * np.sin(9 * x + seed) + noise * rng.normal(size=size)
    at = vertices(x, y, most)
    assert at.size <= most + 2
    assert (np.diff(at) > 0).all() and {at[0], at[-1]} == {0, size - 1}
    if not noise:
        assert np.abs(np.interp(x, x[at], y[at]) - y).max() < 4e-3
    assert np.ptp(y[at]) > np.ptp(y) - 0.01


def test_long_series_share_the_samples_of_a_page():
    x = np.linspace(0, 1, 100_000)
    for count in (1, 12):
        data, noise = ChartData(), np.random.default_rng(1).normal(size=x.size)
        for kind in ("line", "points") * count:
            data.add(chart(Series("", x, noise, "measured", kind)))
        assert sum(column.size for column in columns(data)) <= 2 * 8000 * 1.05


def test_a_column_of_several_charts_is_stored_once():
    x, y = np.arange(5.0), np.arange(5.0) ** 2
    data = ChartData()
    data.add(chart(Series("one", x, y, "measured"), Series("two", x, -y, "simulated")))
    data.add(chart(Series("three", x.copy(), y, "measured")))
    assert len(list(columns(data))) == 3
    assert [[series["x"], series["y"]] for series in json.loads(data.json())["charts"][1]["series"]] == [[0, 1]]


def test_names_cannot_end_the_script_element():
    data = ChartData()
    data.add(chart(Series("</script><b>&", np.zeros(2), np.ones(2), "ink")))
    text = data.json()
    assert "<" not in text and ">" not in text and "&" not in text
    assert json.loads(text)["charts"][0]["series"][0]["name"] == "</script><b>&"


def test_a_logarithmic_axis_stores_exponents():
    data = ChartData()
    axes = Axis("time", "s", (1e-2, 1e3), log=True), Axis("creep", "%")
    data.add(Chart("creep", *axes, (Series("", np.geomspace(1e-2, 1e3, 6), np.ones(6), "measured"),)))
    stored, _ = columns(data)
    assert stored == pytest.approx(np.arange(-2.0, 4.0), abs=1e-3)
    assert json.loads(data.json())["charts"][0]["x"] == {
        "label": "time (s)",
        "unit": "s",
        "log": True,
        "range": [-2, 3],
    }


def test_stems_are_one_curve_of_vertical_lines():
    (line,) = stems("stiffness", np.array([1.0, 2.0]), np.array([5.0, 6.0]), "measured")
    assert line.x.tolist() == [1, 1, 1, 2, 2, 2]
    assert np.array_equal(line.y, [0, 5, np.nan, 0, 6, np.nan], equal_nan=True)
    assert stems("none", np.zeros(0), np.zeros(0), "measured") == ()


@pytest.mark.parametrize("values", [[], [2.0], [2.0, 2.0], [np.nan, np.nan]])
def test_constant_and_empty_columns_are_stored(values):
    data = ChartData()
    data.add(chart(Series("one", np.array(values), np.array(values), "measured")))
    assert np.array_equal(next(columns(data)), values, equal_nan=True)
