"""An emulated controller's GCS 2.0: answers, framing, errors that stay until they are asked for."""

import numpy as np
import pytest
from emulated_stage import spread_coupling
from emulator import Controller
from emulator.gcs_controller import COMMANDS
from hand_clock import Hand
from hypothesis import given
from hypothesis import strategies as st

from dehyst.virtual import PlayActuator, VirtualBench, VirtualStage
from examples import examples


@pytest.fixture
def hand():
    return Hand()


@pytest.fixture
def controller(hand):
    return made(hand)


def made(hand, **options):
    return Controller(VirtualBench(PlayActuator(plays=20, noise=0), clock=hand, limits=(-20, 120), **options))


def error_after(controller, *lines):
    for line in lines:
        assert controller.answer(line) is None
    return int(controller.answer("ERR?"))


def wave(controller, *values):
    return error_after(controller, f"WAV 1 X PNT 1 {len(values)} {' '.join(map(str, values))}")


def test_all_lines_but_the_last_end_with_a_space(controller):
    for query in ("HLP?", "HDR?", "SPA?", "WAV?"):
        lines = controller.answer(query).split("\n")
        assert lines[-1] == ""
        assert all(line.endswith(" ") for line in lines[:-2])
        assert not lines[-2].endswith(" ")


def test_an_unknown_query_has_no_answer_and_its_error_stays_until_asked_for(controller):
    assert controller.answer("FOO?") is None
    assert controller.answer("VOL?") == "1=0\n"
    assert controller.answer("ERR?") == "2\n"
    assert controller.answer("ERR?") == "0\n"
    assert controller.answer("") is None
    assert controller.answer("ERR?") == "0\n"


def test_a_wave_is_played_and_its_record_read_in_the_array_of_gcs(controller, hand):
    values = np.round(30 + 20 * np.sin(np.arange(200) / 20), 6)
    assert wave(controller, *values[:150]) == 0
    rest = " ".join(map(str, values[150:]))
    lines = (f"WAV 1 & PNT 1 50 {rest}", "WSL 1 1", "WGC 1 1", "WTR 1 20 0", "RTR 20", "DRC 1 1 2", "DRC 2 1 16")
    assert error_after(controller, *lines, "DRT 0 1 0") == 0
    assert controller.answer("WAV? 1 1") == "1 1=200\n"
    assert error_after(controller, "WGO 1 1") == 0
    hand.wait(0.0995)
    assert controller.answer("WGO?") == "1=1\n"
    assert controller.answer("DRL?") == "1=100 \n2=100\n"
    assert error_after(controller, "SVA 1 3") == 73
    assert error_after(controller, "WAV 1 X PNT 1 1 0") == 73
    assert "# NDATA = 100 \n" in controller.answer("DRR? 1 200")
    hand.wait(1)
    assert controller.answer("WGO?") == "1=0\n"
    header, rows = controller.answer("DRR? 1 200 1 2").split("# END_HEADER \n")
    assert {"# DIM = 2 ", "# SAMPLE_TIME = 0.001 ", "# NDATA = 200 "} <= set(header.splitlines())
    table = np.array([line.split() for line in rows.splitlines()], dtype=float)
    np.testing.assert_array_equal(table[:, 1], values)
    _, _, displacement = controller.instrument.samples()
    np.testing.assert_allclose(table[:, 0], displacement * 1e6, rtol=1e-11)
    some = controller.answer("DRR? 11 5 2").split("# END_HEADER \n")[1]
    np.testing.assert_array_equal(np.array(some.split(), dtype=float), values[10:15])


NAMES = st.sampled_from([*sorted(COMMANDS), "", "FOO", "PNT"])
WORDS = "1 2 0 -1 1e999 nan 0x10 X & PNT SIN_P 300 5.5 é ٣ LIN RAMP ALL 99999999999999999999 1e-300"
ARGUMENTS = st.sampled_from(WORDS.split())
LINES = st.one_of(
    st.builds(lambda name, rest: " ".join([name, *rest]), NAMES, st.lists(ARGUMENTS, max_size=9)), st.text()
)


@examples(30, nightly=300)
@given(st.lists(LINES, max_size=20))
def test_no_line_breaks_it_nor_leaves_the_limits(lines):
    hand = Hand()
    controller = made(hand, wave_points=1000)
    for line in lines:
        answer = controller.answer(line)
        assert answer is None or answer.endswith("\n")
        hand.wait(0.01)
    controller.answer("ERR?")
    assert controller.answer("ERR?") == "0\n"
    assert controller.instrument.axis.log.lowest >= -20
    assert controller.instrument.axis.log.highest <= 120


class TestSeveralAxes:
    """A controller of three axes: a channel and a wave generator each, one recorder."""

    @pytest.fixture
    def stage(self, hand):
        actuators = [PlayActuator(plays=20, highest=high, noise=0) for high in (100.0, 120.0, 150.0)]
        return VirtualBench(VirtualStage(actuators, np.eye(3) + spread_coupling(3, 0.04), noise=0), clock=hand)

    @pytest.fixture
    def controller(self, stage):
        return Controller(stage)

    def test_of_a_command_with_an_unknown_axis_nothing_is_done(self, controller):
        assert error_after(controller, "SVA 1 10 7 20") == 15
        assert error_after(controller, "SVA 1 10 2 x") == 25
        assert controller.answer("VOL? 1") == "1=0\n"

    def test_a_wave_beyond_the_limits_of_its_axis_is_refused(self, controller, stage):
        assert error_after(controller, "WAV 1 X PNT 1 2 0 140") == 0
        assert error_after(controller, "WSL 1 1 3 1", "WGC 1 1 3 1", "WTR 0 4 0", "RTR 4", "WGO 1 1 3 1") == 17
        assert not stage.playing
        assert error_after(controller, "WGO 3 1") == 0
