"""What records tell of wider models: the model given back, parts told and not told, bands that hold the truth."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import ModelError, Record, identify
from dehyst.identification import Structure
from dehyst.report import write_insight
from dehyst.report.html import document
from dehyst.report.report import render
from dehyst.report.trust_section import sections
from dehyst.trust import insight
from dehyst.trust.bootstrap import resample
from dehyst.trust.evidence import Evidence
from dehyst.trust.identifiability import part_identifiability
from examples import at_night

STRUCTURES = {
    "graded, transformer": Structure(elements=6, grades=3, knots=7, transformer=5),
    "creep": Structure(elements=8, knots=7, creep=3),
    "smooth": Structure(elements=8, knots=7, smooth=True),
}
EVERYTHING = Structure(elements=6, grades=3, knots=7, transformer=5, creep=3, smooth=True)
NOISE = 5e-9


@cache
def truth(name):
    """An actuator of the class whose neighbours are as alike as its structure holds them: one identified itself."""
    plant = structured_records.plant(STRUCTURES[name], seed=100)
    made = identify(plant.record(), structure=STRUCTURES[name], delay=0.0).actuator
    # As a record is taken to begin: smooth elements at none.
    smooth = np.zeros(0 if made.smooth is None else len(made.smooth))
    state = replace(made.turned(float(plant.path[0])), creep=plant.state.creep, smooth=smooth)
    return replace(plant, actuator=replace(made, limits=None), state=state)


def fitted(name, seed=0, noise=NOISE, norm="l1"):
    record = truth(name).record(noise=noise, seed=seed)
    return identify(record, structure=STRUCTURES[name], delay=0.0, norm=norm), record


@cache
def looked(name):
    fit, record = fitted(name)
    path, time = trajectory()
    return insight(fit.actuator, record, trajectory=path, time=time, repeats=20), fit, record


def trajectory():
    path = plain_records.path([1, 0, 1, 0.3, 0.8, 0.1, 0.5, 0.2, 0.9, 0.4, 0.7, 0.2, 0.6, 0.05, 0.5], 40)
    return path, np.arange(path.size) / structured_records.RATE


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_models_own_coefficients_give_the_model_back(name):
    fit, record = fitted(name)
    evidence = Evidence.from_records(fit.actuator, record)
    again = evidence.actuator_of(evidence.model)
    for part in ("slip", "spring", "transformer", "creep", "smooth"):
        one, other = getattr(fit.actuator, part), getattr(again, part)
        assert (one is None) == (other is None)
        for field in () if one is None else one.__dataclass_fields__:
            plain_records.assert_close(
                getattr(other, field), getattr(one, field), 1e-9 * np.abs(getattr(one, field)).max()
            )
    errors = np.concatenate([p[2] - p[3] for one in evidence.comparisons for *_, p in one.played(again)])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(NOISE, rel=0.1)
    assert evidence.stroke == pytest.approx(plain_records.STROKE, rel=0.01)


@pytest.mark.parametrize("name", [at_night("graded, transformer"), "creep", at_night("smooth")])
def test_intervals_are_of_every_part_and_come_again(name):
    found, fit, record = looked(name)
    own, noise = fit.actuator, found.intervals
    assert noise.stiffness.shape == (2, *own.slip.stiffness.shape)
    assert (noise.creep is None) == (own.creep is None)
    assert (noise.smooth is None) == (own.smooth is None)
    assert (noise.drive is None) == (own.transformer is None)
    for _, ends in found.numbers().values():
        assert np.all(ends[0] <= ends[1])
    again = resample(Evidence.from_records(own, record), repeats=20)
    np.testing.assert_array_equal(noise.stiffness, again.stiffness)


def test_twice_the_noise_makes_twice_the_deviations():
    pairs = [fitted("creep", noise=noise) for noise in (NOISE, 2 * NOISE)]
    quiet, loud = (part_identifiability(Evidence.from_records(fit.actuator, record)) for fit, record in pairs)
    for one, other in zip(quiet, loud, strict=True):
        assert one.part == other.part
        ratio = np.median(other.deviations / one.deviations)
        assert ratio == pytest.approx(2, rel=0.3)


def test_what_is_told_is_about_what_resampling_scatters():
    # The second way to the deviation of a creep branch's volts: its interval. Fits keep stiffnesses above zero and
    # neighbours alike, which only sharpens.
    found, fit, _ = looked("creep")
    (part,) = (one for one in found.parts if one.part == "creep")
    half = 0.5 * np.diff(found.intervals.creep, axis=0)[0] / 1.645 * np.ptp(fit.actuator.spring.displacement)
    assert half.max() < 3 * part.deviations.max()
    assert half.max() > 0.2 * part.deviations.min()


def test_a_lone_loop_tells_less():
    structure = STRUCTURES["graded, transformer"]
    plant = truth("graded, transformer")
    short = structured_records.wandering(legs=0, samples=200)
    few = replace(plant, path=short).record(noise=NOISE)
    many = plant.record(noise=NOISE)
    model = identify(many, structure=structure, delay=0.0).actuator
    less, more = (part_identifiability(Evidence.from_records(model, record)) for record in (few, many))
    for one, other in zip(less, more, strict=True):
        assert one.of == other.of
        assert one.known <= other.known
        assert np.all(one.deviations >= other.deviations)
    assert [one.known < other.known for one, other in zip(less, more, strict=True)] == [True, True, False]
    assert less[0].sentence == f"graded elements: {less[0].known} of {less[0].of} combinations known."


def test_a_lone_loop_is_something_to_beware_of():
    plant = truth("graded, transformer")
    short = structured_records.wandering(legs=0, samples=200)
    lone, whole = replace(plant, path=short).record(noise=NOISE), plant.record(noise=NOISE)
    model = replace(plant.actuator, limits=(0.0, plain_records.VOLTS))
    found = insight(model, lone, repeats=0)
    # As the table of identifiability has it: a major loop tells five of ten directions, the last is never told.
    assert (found.identifiability.determined, found.identifiability.of) == (5, 9)
    assert not found.trustworthy
    assert "4 of 9 directions" in found.warnings()[0]
    assert f"Add {found.advice[0].words}" in found.warnings()[0]
    assert found.advice[0].determined == 9
    assert insight(model, whole, repeats=0).trustworthy


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_look_at_a_wider_model(name):
    found, fit, _ = looked(name)
    told_ = json.loads(json.dumps(found.as_dict()))
    assert told_["not_judged"] == found.not_judged != ""
    assert told_["homing"]["certified"] == found.homing.certified
    assert found.band.open is None
    assert set(found.band.errors()) == {"noise", "misfit", "clamped"}
    assert found.loop.off < 0.01 * plain_records.STROKE
    assert found.knowledge[0].by_displacement is not None
    assert found.knowledge[0].judged == (name == "graded, transformer")
    text = document("", sections(found, found.turns))
    for words in (
        "What the records determine of each part",
        "How accurate the parts are",
        "The promise along the path",
        "Where the records turned",
        "Not judged",
        "When the state becomes known",
    ):
        assert words in text
    assert "records determine" in render(fit, insight=found)


def test_the_state_is_known_from_the_voltage_as_from_two_simulations():
    found, fit, record = looked("graded, transformer")
    when = found.knowledge[0].by_voltage
    first = round(when / record.sample_time) + 1
    ends = [fit.actuator.turned(y, rising=up, extrapolate=True) for y, up in ((1e-3, False), (-1e-3, True))]
    reached = [
        fit.actuator.simulate(record.voltage[:first], state=one, extrapolate=True).displacement[-1] for one in ends
    ]
    assert abs(reached[1] - reached[0]) < 1e-9 * plain_records.STROKE


def test_another_actuators_record_is_told():
    _, fit, record = looked("creep")
    other = Record(record.time, record.voltage, 0.8 * record.displacement, "other")
    found = insight(fit.actuator, other, repeats=0)
    assert "another actuator" in found.warnings()[0]
    assert found.intervals is None
    assert found.loop is None


def test_limits_beyond_the_records_are_told():
    _, fit, record = looked("creep")
    low, high = fit.actuator.limits
    found = insight(fit.actuator, record, repeats=0, limits=(low, high + 40))
    assert "extrapolated" in found.warnings()[0]


def test_a_creeping_model_asks_for_the_time_of_a_trajectory():
    _, fit, record = looked("creep")
    with pytest.raises(ModelError, match="answer depends") as refused:
        insight(fit.actuator, record, trajectory=trajectory()[0], repeats=20)
    assert "time" in refused.value.change


def test_everything_at_once_with_and_without_repeats(tmp_path):
    plant = structured_records.plant(EVERYTHING)
    record = plant.record(noise=NOISE)
    fit = identify(record, structure=EVERYTHING, delay=0.0)
    found = insight(fit.actuator, record, repeats=20)
    assert {one.part for one in found.parts} == {
        "graded elements",
        "parallel spring",
        "creep",
        "smooth elements",
        "transformer",
    }
    write_insight(tmp_path / "page.html", found, command="dehyst insight")
    assert "Transformer" in (tmp_path / "page.html").read_text()


def test_the_command(tmp_path):
    from click.testing import CliRunner

    from dehyst.cli import main
    from dehyst.records import write_columns

    _, fit, record = looked("creep")
    path, time = trajectory()
    model, data, wanted, band = (str(tmp_path / name) for name in ("m.json", "r.csv", "w.csv", "b.csv"))
    fit.actuator.save(model)
    write_columns(
        data, {"time_s": record.time, "voltage_V": record.voltage, "displacement_um": record.displacement * 1e6}
    )
    write_columns(wanted, {"time_s": time, "displacement_um": path * 1e6})
    said = CliRunner().invoke(
        main, ["insight", model, data, "--trajectory", wanted, "-o", band, "--options", '{"repeats": 20}', "--all"]
    )
    assert said.exit_code in (0, 1)
    for words in (
        "Known of each part",
        "the displacement on the major loop",
        "Not judged of a model with more parts than slip elements and a spring",
        "not judged from the voltage alone",
        "Causes of",
    ):
        assert words in said.stdout
    assert "models that the records do not contradict" not in said.stdout
    assert (tmp_path / "b.csv").read_text().startswith("time_s,wanted_um,voltage_V")


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["graded, transformer", "creep"])
def test_a_band_of_90_percent_holds_the_truth_about_as_often(name):
    # Of each of twelve records with fresh noise: how much of a path, compensated by the truth, lies in the band.
    plant, (path, time) = truth(name), trajectory()
    clock = time if plant.actuator.needs_time else None
    voltage = plant.actuator.compensate(path, time=clock, state=plant.state).voltage
    held = []
    for seed in range(12):
        fit, record = fitted(name, seed=1 + seed)
        found = resample(Evidence.from_records(fit.actuator, record), repeats=40, seed=seed)
        low, high = found.prediction(voltage, lambda one: one.turned(float(path[0])), clock)
        held.append(np.mean(((low <= path) & (path <= high))[120:]))
    assert 0.80 <= np.mean(held) <= 0.97
