"""An emulated controller's GCS 2.0: answers, framing, errors that stay until they are asked for."""

import pytest
from emulator import Controller
from emulator.gcs_controller import COMMANDS
from hand_clock import Hand
from hypothesis import given
from hypothesis import strategies as st

from dehyst.virtual import PlayActuator, VirtualBench
from examples import examples


@pytest.fixture
def hand():
    return Hand()


@pytest.fixture
def controller(hand):
    return made(hand)


def made(hand, **options):
    return Controller(VirtualBench(PlayActuator(plays=20, noise=0), clock=hand, limits=(-20, 120), **options))


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
