"""The identification of a stage: coupling, axes, and whether coupling is a matrix."""

from dataclasses import replace

import coupled_stage
import numpy as np
import pytest

import dehyst
from dehyst.identification.coupling.matrix import PlayColumns, coupling_by_plays

OFF = ~np.eye(2, dtype=bool)


@pytest.fixture(scope="module")
def fit():
    training, _ = coupled_stage.excited()
    held, found = coupled_stage.excited(7, steps=2)
    first, stop = found.parts[-1][1:]
    return dehyst.identify_stage(training, validate=replace(held[first:stop], name="held-out"))


def exchanged(record):
    """The same record with its axes in the other order."""
    return replace(
        record, voltage=record.voltage[:, ::-1], displacement=record.displacement[:, ::-1], axes=record.axes[::-1]
    )


def test_matrix_and_held_out_record(fit):
    assert np.abs(fit.coupling - coupled_stage.COUPLING)[OFF].max() < 0.002
    held = [error for error in fit.errors if error.role == "validation"]
    assert max(error.rms_percent for error in held) < 0.1
    assert fit.is_matrix
    assert fit.good
    assert fit.stage.condition == fit.condition < 1.2
    assert np.all(fit.rank_one_share > 0.999)
    assert fit.as_dict()["coupling"] == fit.stage.coupling.tolist()


def test_an_axis_that_stands_at_first_is_judged_where_it_moves():
    """Of y nothing is known before its first turns: it came to 50 V from below, where no loop of the record goes."""
    fit = dehyst.identify_stage(coupled_stage.excited(base=(0.0, 50.0))[0])
    of_y = fit.errors[1]
    whole = fit.fits[1].errors[0]
    assert whole.largest > 0.01 * whole.stroke
    assert of_y.largest_percent < 0.2
    assert of_y.left_out > 1000
    assert all(one.expectation.readiness.name == "READY" for one in fit.fits)


def test_an_axis_without_a_model_is_named(fit):
    none = replace(fit, stage=None, fits=(fit.fits[0], replace(fit.fits[1], actuator=None)), axes=("x", "second"))
    assert none.exchanged == () and not none.good
    assert none.verdict.endswith(" second")


def test_exchanged_columns_of_displacements_are_not_usable():
    training, _ = coupled_stage.excited(coupling=np.array([[1.0, 0.05], [0.04, 1.0]]))
    turned = dehyst.Record(training.time, training.voltage, training.displacement[:, ::-1], "turned", axes=("x", "y"))
    found = dehyst.identify_stage(turned, structure="maxwell_slip")
    assert found.exchanged == ("x", "y")
    assert not found.good


def test_the_stage_follows_a_path_on_the_truth(fit):
    """What the compensator plays on the true stage brings both axes where they are wanted."""
    t = np.arange(0, 20, 0.02)
    wanted = 1e-6 * np.column_stack([7 + 4 * np.sin(0.9 * t), 9 + 5 * np.sin(0.6 * t + 1)])
    wanted[:100] *= np.linspace(0, 1, 100)[:, None]
    start = fit.stage.actuators
    states = [one.turned(0.0, rising=False) for one in start]
    voltage = fit.stage.compensate(wanted, time=t, states=states).voltage
    reached = coupled_stage.played(t, voltage, noise=0.0).displacement
    settled = slice(300, None)
    left = reached[settled] - wanted[settled]
    assert np.all((left - left.mean(axis=0)).std(axis=0) < 1e-3 * np.array([16e-6, 20e-6]))


@pytest.mark.parametrize("cycles", [0, 8])
def test_axes_one_after_the_other_and_together(cycles):
    training, _ = coupled_stage.excited(cycles=cycles)
    found = coupling_by_plays(PlayColumns.of([training]))
    assert np.abs(found.matrix - coupled_stage.COUPLING)[OFF].max() < 0.002
    assert np.all(found.uncertainty[OFF] < 0.002)


def test_other_zeros_of_the_voltages_give_the_same_matrix():
    training, _ = coupled_stage.excited()
    found = coupling_by_plays(PlayColumns.of([training])).matrix
    middle = replace(training, voltage=training.voltage - 0.5 * (training.voltage.min(0) + training.voltage.max(0)))
    assert np.allclose(found, coupling_by_plays(PlayColumns.of([middle])).matrix, rtol=0, atol=1e-9)


def test_other_order_of_the_axes_gives_the_same_matrix():
    training, _ = coupled_stage.excited()
    found = coupling_by_plays(PlayColumns.of([training])).matrix
    other = coupling_by_plays(PlayColumns.of([exchanged(training)])).matrix
    assert np.allclose(found, other[::-1, ::-1], rtol=0, atol=1e-9)


def test_coupling_with_hysteresis_is_found_out():
    training, _ = coupled_stage.excited(bent=0.04)
    fit = dehyst.identify_stage(training, structure="maxwell_slip")
    assert not fit.is_matrix
    assert fit.cross_talk.beyond[1, 0]
    assert not fit.cross_talk.beyond[0, 1]
    assert len(fit.remarks) > 0


TRAINING, _ = coupled_stage.excited()
(X, Y), NOISE = TRAINING.displacement.T, np.random.default_rng(1).normal(0, 5e-9, len(TRAINING))
STILL = np.column_stack([TRAINING.voltage[:, 0], np.full(len(TRAINING), 3.0)])
TOGETHER = np.column_stack([TRAINING.voltage[:, 0], 1.2 * TRAINING.voltage[:, 0]])


@pytest.mark.parametrize(
    ("voltage", "x", "y"),
    [
        (TRAINING.voltage, X, 2e-6 + NOISE),
        (TRAINING.voltage, X, X + 1e-6),
        (STILL, X, Y),
        (TRAINING.voltage, np.full_like(X, 1e-6), Y),
        (TOGETHER, *coupled_stage.played(TRAINING.time, TOGETHER).displacement.T),
    ],
    ids=["follows none", "the same twice", "constant voltage", "stands", "always together"],
)
def test_axes_that_tell_no_coupling_are_refused(voltage, x, y):
    with pytest.raises((dehyst.RecordError, dehyst.IdentifyError)):
        dehyst.identify_stage(dehyst.Record(TRAINING.time, voltage, np.column_stack([x, y]), "changed"))


def test_records_of_other_axes_are_refused():
    training, _ = coupled_stage.excited()
    with pytest.raises(dehyst.RecordError, match="order"):
        dehyst.identify_stage([training, exchanged(training)])
    with pytest.raises(dehyst.RecordError, match="several axes"):
        dehyst.identify_stage(training.axis(0))
