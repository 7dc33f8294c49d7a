"""Histories of checks: one file each, control charts over them, and folders of others left alone."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import checked_loops as loops
import numpy as np
import pytest

import dehyst
from dehyst import FileFormatError, IdentifyError
from dehyst.trust import CheckHistory
from dehyst.trust.history import ALLOWANCE, DECISION, LIMIT, WEIGHT, ControlChart
from dehyst.trust.recheck import Standing

DAY = datetime(2024, 5, 1, 8, tzinfo=UTC)


def chart(scores):
    scores = np.asarray(scores, dtype=np.float64)
    return ControlChart.of("gain", np.arange(scores.size, dtype=np.float64), 0.1 * scores, scores)


def kept(folder, gains):
    """The history of a check a day, of an actuator of these gains."""
    for day, gain in enumerate(gains):
        recheck = dehyst.check(loops.model(), loops.later(day, gain=gain))
        history = CheckHistory.keep(folder, recheck, moment=DAY + timedelta(days=day))
    return history


def test_averages_and_sums_are_the_textbooks():
    scores = np.random.default_rng(0).normal(size=50)
    found = chart(scores)
    weights = WEIGHT * (1 - WEIGHT) ** np.arange(50)
    assert found.average[-1] == pytest.approx(weights @ scores[::-1])
    # The standard deviation of that average, for scores of variance 1.
    np.testing.assert_allclose(found.limits[[0, -1]], LIMIT * np.array([WEIGHT, np.sqrt(np.sum(weights**2))]))
    steps = np.cumsum(scores - ALLOWANCE)
    np.testing.assert_allclose(found.above, steps - np.minimum(np.minimum.accumulate(steps), 0), atol=1e-12)
    np.testing.assert_allclose(chart(-scores).below, found.above)


def test_a_steady_process_stays_inside_and_a_small_lasting_shift_is_found():
    noise = np.random.default_rng(1).normal(size=(200, 30)) / 3
    assert not any(chart(one).alarms.any() for one in noise)
    # Single checks would not count: they need three.
    shifted = [chart(one + 1.8) for one in noise]
    assert all(one.outside and one.since < 12 for one in shifted)
    assert max(one.scores.max() for one in shifted) < 3.5
    assert chart([0.0] * 4 + [9.0]).outside and chart([0.0] * 4 + [9.0]).since == 4
    assert DECISION > 3


def test_a_gain_that_creeps_up_is_found_before_a_single_check_counts(tmp_path):
    history = kept(tmp_path / "new", [0.0, 0.0, 0.0, *[0.002] * 7])
    assert [one.record for one in history.checks] == [f"later-{day}" for day in range(10)]
    assert {one.standing for one in history.checks} <= {Standing.STILL_TRUE.name, Standing.WITHIN_GOAL.name}
    gain = next(one for one in history.charts() if one.name == "gain")
    assert np.abs(gain.scores).max() < 3
    assert 3 < gain.since < 9
    (sentence,) = history.sentences()
    assert sentence.startswith("Gain: ") and f"(2024-05-{gain.since + 1:02d})" in sentence
    assert history.as_dict()["charts"][0]["outside"] is True
    np.testing.assert_allclose(history.average_error()[:1], history.checks[0].error)
    assert json.dumps(history.as_dict())


def test_a_record_checked_again_keeps_its_place(tmp_path):
    recheck = dehyst.check(loops.model(), loops.later())
    CheckHistory.keep(tmp_path, recheck, moment=DAY)
    CheckHistory.keep(tmp_path, dehyst.check(loops.model(), loops.later(2)), moment=DAY + timedelta(days=1))
    history = CheckHistory.keep(tmp_path, dehyst.check(loops.model(), loops.later(), goal=2.0))
    assert [(one.checked.day, one.goal) for one in history.checks] == [(1, 2.0), (2, 1.0)]


def test_another_model_begins_anew(tmp_path):
    CheckHistory.keep(tmp_path, dehyst.check(loops.model(), loops.later()))
    other = replace(loops.model(), delay=0.01)
    history = CheckHistory.keep(tmp_path, dehyst.check(other, loops.later()))
    assert (len(history.checks), history.others) == (1, 1)
    assert len(CheckHistory.read(tmp_path, loops_id := history.checks[0].model_id).checks) == 1
    assert CheckHistory.read(tmp_path / "absent", loops_id).checks == ()


def test_folders_and_files_of_others_are_refused(tmp_path):
    recheck = dehyst.check(loops.model(), loops.later())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(FileFormatError, match=r"files \(notes.txt\)"):
        CheckHistory.keep(tmp_path / "mine", recheck)
    CheckHistory.keep(tmp_path / "own", recheck)
    (path,) = (tmp_path / "own").glob("check-*.json")
    good = json.loads(path.read_text())
    for key, value in (("changes", 3), ("checked", "2024-05-01"), ("checked", "never"), ("goal_percent", None)):
        path.write_text(json.dumps({**good, key: value}))
        with pytest.raises(FileFormatError, match="written by dehyst"):
            CheckHistory.read(tmp_path / "own", recheck.model_id)
    with pytest.raises(FileFormatError, match="time zone"):
        CheckHistory.keep(tmp_path / "own", recheck, moment=datetime(2024, 5, 1))


def test_a_record_of_another_actuator_is_refused(tmp_path):
    recheck = dehyst.check(loops.model(), loops.later(gain=0.7))
    assert not recheck.good and re.search(r"differs by \+6\d", recheck.mismatch)
    with pytest.raises(IdentifyError, match="the model's actuator"):
        CheckHistory.keep(tmp_path / "new", recheck)
    assert not (tmp_path / "new").exists()
    assert not dehyst.check(loops.model(), loops.later(gain=0.3)).mismatch


def test_damaged_checks_are_left_out_of_what_is_kept(tmp_path):
    first = CheckHistory.keep(tmp_path, dehyst.check(loops.model(), loops.later()))
    (path,) = tmp_path.glob("check-*.json")
    path.write_text("{}")
    history = CheckHistory.keep(tmp_path, dehyst.check(loops.model(), loops.later(2)))
    assert [one.record for one in history.checks] == ["later-2"]
    assert len(history.damaged) == 1 and path.name in history.damaged[0]
    assert CheckHistory.read(tmp_path, first.checks[0].model_id, throw=False).damaged == history.damaged
