"""The end of a search: a limit of time or a request, what is left out, and the model that remains."""

import signal
import time

import numpy as np
import pytest
import structured_records as wide

import dehyst
from dehyst import IdentifyError
from dehyst.identification import Deadline, Structure, structure_selection
from dehyst.identification.structure_selection import StructureTrial, Tried, select, simplest

START = Structure()


@pytest.fixture(scope="module")
def record():
    return wide.plant(wide.STRUCTURES["graded"]).record(noise=1e-9)


def test_a_step_does_not_begin_after_the_limit():
    endless, deadline = Deadline(), Deadline(1e-9)
    assert (endless.left, endless.passed, endless.attempt(lambda: 1, 2, "a step")) == (np.inf, False, 1)
    assert deadline.passed and deadline.left == 0
    assert deadline.attempt(pytest.fail, 2, "the search") == 2
    assert deadline.attempt(pytest.fail, None, "the tuning") is None
    assert deadline.cut == ["the search", "the tuning"]
    assert (len(endless.remarks("one")), len(deadline.remarks("one"))) == (0, 1)


def test_a_step_that_looks_at_the_deadline_is_left():
    deadline, said = Deadline(), []
    report = deadline.watched(said.append)

    def step():
        report("begins")
        deadline.end("Ctrl-C")
        report("goes on")

    deadline.check()
    assert deadline.attempt(step, "so far", "the step") == "so far"
    assert said == ["begins"]
    # Outside of a step progress is only reported.
    report("finishing")
    assert said == ["begins", "finishing"]


def test_a_step_inside_another_is_left_with_it():
    deadline = Deadline()

    def outer():
        deadline.end()
        return deadline.attempt(lambda: 1, 2, "inner")

    assert deadline.attempt(outer, 3, "outer") == 3
    assert deadline.cut == ["outer"]


def test_an_error_in_a_step_is_an_error():
    deadline = Deadline()
    with pytest.raises(ZeroDivisionError):
        deadline.attempt(lambda: 1 / 0, 0, "a step")
    assert deadline.cut == []


def test_a_signal_handler_leaves_a_step_that_looks_at_nothing():
    deadline = Deadline()
    before = signal.signal(signal.SIGINT, lambda *_: deadline.end("Ctrl-C", leave_step=True))
    try:

        def step():
            signal.raise_signal(signal.SIGINT)
            time.sleep(0)
            pytest.fail("the step went on")

        assert deadline.attempt(step, 7, "a step") == 7
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("limit", [0, -1, float("nan"), float("inf"), "5", True])
def test_impossible_limits_are_refused(record, limit):
    with pytest.raises(IdentifyError):
        dehyst.identify(record, time_limit=limit)


def tried_until(monkeypatch, deadline, count, error):
    """Let the deadline pass after so many trials, with a held-out error by structure."""
    done = []

    def trial(build, structure, progress, before=None):
        progress(structure.words)
        done.append(structure)
        if len(done) == count:
            deadline.end()
        return Tried(StructureTrial(structure, error(structure), 0.0, 0.0))

    monkeypatch.setattr(structure_selection, "try_structure", trial)


def test_a_search_ends_with_the_best_so_far(monkeypatch):
    deadline, said = Deadline(), []
    tried_until(monkeypatch, deadline, 4, lambda one: 2e-8 / one.grades)
    best, trials = select(None, START, said.append, stroke=1e-5, deadline=deadline)
    # By itself, more elements, a transformer, grades; not creep.
    assert best.grades == 8
    assert len(trials) == 4
    assert (len(deadline.cut), len(said)) == (1, 4)


def test_a_part_that_is_not_worth_it_is_not_taken_at_the_deadline_either(monkeypatch):
    deadline = Deadline()
    tried_until(monkeypatch, deadline, 3, lambda one: 1.0 - 0.02 * (one.elements == 40))
    assert select(None, START, lambda _: None, deadline=deadline)[0] == START
    assert select(None, START, None, deadline=deadline) == (START, ())


def test_the_simplest_of_the_best():
    def trial(error, **parts):
        return StructureTrial(Structure(**parts), error, 0.0, 0.0)

    trials = [trial(2.0), trial(1.02, transformer=20), trial(1.0, grades=8), trial(0.5, creep=9)]
    assert simplest(trials, creep=True).creep == 9
    assert simplest(trials, creep=False).transformer == 20
    assert simplest([], creep=True) is None


def ended_at(words):
    """A deadline, and a report of progress that ends it at a sentence that begins with these words."""
    deadline = Deadline()

    def progress(sentence):
        if sentence.startswith(words):
            deadline.end("A request")

    return {"time_limit": deadline, "progress": progress}


@pytest.mark.parametrize("words", ["looking for inertia", "trial 2", "solving the program"])
def test_the_model_at_a_deadline_is_usable(record, words):
    fit = dehyst.identify(record, **ended_at(words))
    assert fit.outcome.good
    assert fit.remarks[0].startswith("A request ended ")
    assert fit.actuator.identification.norm == fit.options["norm"] == "l2"
    assert max(error.largest_percent for error in fit.errors) < 5
    voltage = np.linspace(*fit.actuator.limits, 50)
    assert np.isfinite(fit.actuator.simulate(voltage, time=np.arange(50) / 10).displacement).all()


@pytest.mark.nightly
def test_a_limit_that_is_not_reached_changes_nothing(record):
    free, limited = (dehyst.identify(record, norm="l2", time_limit=limit) for limit in (None, 1e6))
    assert free.remarks == limited.remarks
    assert free.actuator.slip.stiffness.tobytes() == limited.actuator.slip.stiffness.tobytes()


@pytest.mark.parametrize("structure", ["auto", "maxwell_slip", Structure(elements=10)])
def test_a_first_model_comes_once_and_says_that_it_is_provisional(record, structure):
    models, sentences = [], []

    def first_model(actuator):
        models.append((actuator, list(sentences)))

    fit = dehyst.identify(record, structure=structure, first_model=first_model, progress=sentences.append)
    [(first, before)] = models
    assert first.identification.provisional
    assert first.identification.norm == "l2"
    assert not fit.actuator.identification.provisional
    assert not any(words.startswith("trial") for words in before)
    path = np.linspace(*record.voltage_range, 50)
    assert np.ptp(first.simulate(path).displacement) == pytest.approx(np.ptp(record.displacement), rel=0.2)


def test_ctrl_c_in_python_is_a_keyboard_interrupt(record):
    def progress(words):
        if words.startswith("trial 3"):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        dehyst.identify(record, progress=progress)
