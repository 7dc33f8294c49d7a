"""Whatever comes over the link, no voltage leaves the limits, nothing hangs, and what is raised is ours."""

import random
import time
import warnings

import numpy as np
import pytest
from fake_gcs import FakeController
from faulty_link import Meddling, PipeLink, QuickRig
from pi_on_emulator import by_tcp

from dehyst._errors import DehystError
from dehyst.instruments import LinkError
from dehyst.instruments.pi import PiRig
from dehyst.waveforms import Excitation
from examples import at_night

DEVICE, ALLOWED = (-20.0, 120.0), (0.0, 60.0)
ODD = [np.nan, np.inf, -np.inf, 1e308, -1e308, 60.0000001, -1e-9, 5e-324, 0.0, 60.0, 119.0]
# Microvolts that voltages are rounded to.
ROUNDED = 2e-6


def excitation(rng, slew_rate):
    """Mostly one that may be played; some leave the limits or are too steep."""
    count, rate = rng.randint(2, 300), rng.choice([100.0, 333.3, 1000.0, 20000.0])
    low, high = rng.choice([(0.0, 60.0), (10.0, 20.0), (5.0, 6.0), (-3.0, 30.0), (30.0, 61.0)])
    turn = min(0.3, rng.uniform(0.1, 1.1) * slew_rate / (0.5 * (high - low) * rate))
    phase = rng.uniform(0, 6) + turn * np.arange(count)
    return Excitation("odd", low + (high - low) * 0.5 * (1 - np.cos(phase)), rate)


def act(rig, rng):
    """Do one thing at random; what is raised must be ours."""
    listened = rng.choice([None, None, 1, 3])

    def listen(_):
        nonlocal listened
        if listened is not None:
            listened -= 1
            if listened == 0:
                raise DehystError("enough")

    try:
        match rng.choice(["set", "read", "play", "retreat"] if rng.random() < 0.98 else ["close"]):
            case "set":
                rig.set_voltage(rng.choice(ODD) if rng.random() < 0.4 else rng.uniform(-30, 130))
            case "read":
                rig.read()
            case "play":
                rig.play(excitation(rng, rig.slew_rate), listen)
            case "retreat":
                rig.retreat()
            case "close":
                rig.close()
    except DehystError:
        return False
    return True


def refuse_excess(bench, lines=()):
    """Both sides: what the bench has put out, and what it was sent."""
    assert ALLOWED[0] <= bench.axis.log.lowest
    assert bench.axis.log.highest <= ALLOWED[1]
    assert bench.axis.log.refused == 0
    for line in lines:
        word, *rest = line.split() or [""]
        sent = rest[1:] if word == "SVA" else rest[5:] if word == "WAV" else []
        assert all(ALLOWED[0] <= float(value) <= ALLOWED[1] for value in sent), line


def life(seed, share):
    """A rig's life with a meddler on the line: replies that were changed, acts without an error, and seconds."""
    rng, began = random.Random(seed), time.process_time()
    slew_rate = rng.uniform(50, 5000)
    controller = FakeController(limits=DEVICE)
    meddle, done = Meddling(seed, share if rng.random() < 0.3 else 0.0), 0
    try:
        rig = QuickRig(PipeLink(controller, meddle), limits=ALLOWED, slew_rate=slew_rate)
    except DehystError:
        pass
    else:
        meddle.share = share
        done = sum(act(rig, rng) for _ in range(rng.randint(1, 8)))
        rig.close()
    refuse_excess(controller.bench, controller.lines)
    assert share or controller.bench.axis.log.largest_step <= 0.01 * slew_rate + ROUNDED
    return meddle.count, done, time.process_time() - began


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("share", "replies"), [(0.02, 150), at_night(0.05, 4000), (0.3, 500)])
def test_fuzzed_replies_never_move_a_voltage_out_of_its_limits(share, replies):
    seed = changed = 0
    while changed < replies:
        count, _, seconds = life(int(1e6 * share) + seed, share)
        assert seconds < 1.0
        changed, seed = changed + count, seed + 1


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("sequences", [60, at_night(1000)])
def test_random_calls_keep_limits_and_slew_rate(sequences):
    assert sum(life(seed, 0.0)[1] for seed in range(sequences)) > sequences


@pytest.mark.parametrize("seed", range(40))
def test_ctrl_c_during_an_answer_causes_a_retreat(seed):
    rng = random.Random(seed)
    controller = FakeController(limits=DEVICE)
    rig = QuickRig(PipeLink(controller), limits=ALLOWED, slew_rate=2000.0)
    rig.set_voltage(30.0)
    pipe, left = rig._client._link._socket, rng.randint(1, 60)
    receive, send = pipe.recv, pipe.sendall

    def interrupted(call):
        def method(argument):
            nonlocal left
            left -= 1
            if left == 0:
                if call == send:
                    send(argument[: rng.randrange(len(argument))])
                raise KeyboardInterrupt
            return call(argument)

        return method

    pipe.recv, pipe.sendall = interrupted(receive), interrupted(send)
    wave = Excitation("there and back", 30 + 30 * np.sin(np.linspace(0, 6.28, 200)), 1000.0)
    with pytest.raises(KeyboardInterrupt) as caught:
        while True:
            rig.play(wave)
    assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
    assert controller.bench.axis.voltage == 0.0
    refuse_excess(controller.bench, controller.lines)
    assert rig.set_voltage(12.5) == 12.5


def test_a_second_client_is_refused_and_the_first_is_not_disturbed():
    with by_tcp(limits=ALLOWED) as (rig, _):
        host, port = rig.name.rpartition(" ")[2].split(":")
        with pytest.raises(LinkError, match="client connected"):
            PiRig.connect(host, int(port), timeout=0.3)
        assert rig.set_voltage(3.0) == 3.0


def test_ten_thousand_samples_come_quickly():
    wave = Excitation("many", 30 - 30 * np.cos(np.linspace(0, 30, 10000)), 1000.0)
    with by_tcp(speed=1000.0, limits=ALLOWED) as (rig, _), warnings.catch_warnings():
        warnings.simplefilter("error")
        began = time.process_time()
        record = rig.play(wave)
        assert time.process_time() - began < 5
    assert np.abs(record.voltage - wave.voltage).max() < 1e-6
