"""The rig process at its pipes: what it refuses, what it plays, and that no reader can hold it up."""

import fcntl
import json
import re
import shlex
import time

import numpy as np
import pytest
from observed_rig import LIMITS, SLEW, ObservedController, held, on_disk, triangle

from dehyst import read
from dehyst.calibration.plan import Plan, entries
from dehyst.instruments import open_rig


@pytest.fixture
def holder(tmp_path):
    with held(tmp_path) as holder:
        yield holder


@pytest.fixture
def simulated(holder):
    holder.connect("sim://play", slew=2000.0)
    return holder


def answered(holder, count):
    """Wait for so many errors, and return them."""
    holder.until(lambda: len([one for one in holder.messages if one["kind"] == "error"]) >= count)
    return holder.errors_sent()


def refused(holder, **command):
    """Send a command, and return the error that it gets."""
    before = len(holder.errors_sent())
    holder.send(**command)
    return answered(holder, before + 1)[-1]


RIG = {"rig": "sim://play"}


def calibration(folder, **more):
    """Parameters of a calibration into a folder."""
    return {**RIG, "output": str(folder / "out"), "frequency": 5, **more}


def play(holder, file, name="wave"):
    holder.send(do="play", file=str(file), record=str(holder.folder / f"{name}.h5"))


LINES = [
    (b"{broken\n", "not JSON"),
    (b"\xff\xfe\n", "not JSON"),
    (b"[" * 50_000 + b"\n", "not JSON"),
    (b"[1, 2]\n", "need an object"),
    (b'"stop"\n', "need an object"),
    (b'{"do": "fly"}\n', "need one of connect, arm"),
    (b'{"do": ["play"]}\n', "need one of"),
    (b"{}\n", "need one of"),
    (b'{"do": "play", "x": "' + b"a" * 2_000_000 + b'"}\n', "more than 65536 bytes"),
]


def test_a_line_that_is_no_command_is_refused_and_the_next_one_obeyed(holder):
    for count, (line, why) in enumerate(LINES, 1):
        holder.raw(line)
        assert why in answered(holder, count)[-1]
    holder.connect("sim://play")
    assert holder.state["status"] == "connected"


IMPOSSIBLE = [
    {"do": "connect", "address": 5},
    {"do": "connect", "address": "sim://play", "limits": [0]},
    {"do": "connect", "address": "sim://play", "limits": ["0", "9"]},
    {"do": "connect", "address": "sim://play", "limits": [100, 0]},
    {"do": "connect", "address": "sim://play", "slew": True},
    {"do": "connect", "address": "sim://nothing"},
    {"do": "connect", "address": "pi://127.0.0.1:1"},
    {"do": "arm", "limits": [0, 1], "slew": 1},
    {"do": "plan"},
]


def test_a_command_with_impossible_fields_is_refused(holder):
    for command in IMPOSSIBLE:
        assert refused(holder, **command), command
    holder.connect("sim://play")
    assert holder.state["status"] == "connected"


UNCONFIRMED = [
    {},
    {"limits": list(LIMITS)},
    {"limits": [0.0, 200.0], "slew": SLEW},
    {"limits": [-1.0, 100.0], "slew": SLEW},
    {"limits": list(LIMITS), "slew": 99.99},
    {"limits": list(LIMITS), "slew": None},
    {"limits": None, "slew": SLEW},
]


def test_arming_needs_the_limits_and_the_slew_rate_in_force(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address)
        for confirmation in UNCONFIRMED:
            assert "arm: got" in refused(holder, do="arm", identity=holder.state["identity"], **confirmation)
            assert holder.state["status"] == "connected"


def test_arming_needs_the_identity_of_the_connected_rig(simulated):
    confirmed = {name: simulated.state[name] for name in ("limits", "slew")}
    for identity in (None, "", "another rig"):
        assert "arm: got the rig" in refused(simulated, do="arm", identity=identity, **confirmed)
        assert simulated.state["status"] == "connected"


def test_a_plan_with_impossible_numbers_is_refused(simulated):
    for plan in ({"frequency": 0}, {"goal": 0}, {"frequency": -1}, {"goal": 1e-300}):
        assert next(iter(plan)) in refused(simulated, do="plan", given={**RIG, **plan})
        assert simulated.state["plan"] is None


def test_a_request_with_an_id_is_answered_once(tmp_path):
    def outcomes(holder):
        holder.settle()
        return {one["id"]: one for one in holder.messages if one["kind"] == "done"}

    with ObservedController() as controller, held(tmp_path) as holder:
        holder.send(do="stop", id=1)
        holder.connect(controller.address)
        holder.send(do="plan", given={**RIG, "frequency": 0}, id=2)
        holder.until(lambda: 2 in outcomes(holder))
        holder.arm()
        holder.play()
        holder.send(do="arm", id=3)
        holder.send(do="stop", id=4)
        holder.until(lambda: 4 in outcomes(holder))
        holder.send(do="plan", id=5)
        holder.until(lambda: 5 in outcomes(holder))
        found = outcomes(holder)
        assert sorted(found) == [1, 2, 3, 4, 5] == [one["id"] for one in holder.messages if one["kind"] == "done"]
        assert [found[1]["armed"], found[4]["armed"]] == [False, True]
        assert "frequency" in found[2]["error"]
        assert "busy" in found[3]["error"]


def test_the_words_of_a_stop_go_when_the_rig_is_armed(simulated, tmp_path):
    simulated.arm()
    assert simulated.press() == 200
    simulated.until(lambda: simulated.state["status"] == "connected" and simulated.state["words"])
    simulated.arm()
    assert simulated.state["words"] == []
    assert simulated.state["error"] is None


def test_the_emergency_stop_says_if_nothing_was_armed(simulated):
    assert simulated.press() == 409


def test_a_later_stop_keeps_the_reason_of_the_first(simulated):
    simulated.arm()
    assert simulated.press() == 200
    simulated.until(lambda: simulated.state["status"] == "connected" and len(simulated.state["words"]) == 2)
    first = simulated.state["words"]
    for _ in range(2):
        simulated.state["words"] = []
        assert simulated.press() == 409
        simulated.until(lambda: simulated.state["words"])
        assert simulated.state["words"][:2] == first and len(simulated.state["words"]) == 4


@pytest.mark.parametrize("command", [{"do": "play"}, {"do": "calibrate", "given": {"output": "out"}}])
def test_nothing_moves_a_voltage_unless_armed(command, tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address)
        command |= {"file": str(triangle(tmp_path)), "record": str(tmp_path / "wave.h5")}
        assert "not armed" in refused(holder, **command)
        for do in ("stop", "disarm"):
            holder.state["words"] = []
            holder.send(do=do)
            holder.until(lambda: holder.state["words"][1:] == ["Nothing was armed, and the voltage was not moved."])
        holder.send(do="plan", given=RIG)
        holder.until(lambda: holder.state["plan"] is not None)
        assert not controller.put_out()[1].any()
        assert not list(tmp_path.glob("*.h5*"))


def test_a_rig_that_stands_outside_the_limits_is_not_armed(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        controller._bench.axis.set_voltage(150.0)
        holder.connect(controller.address)
        confirmed = {name: holder.state[name] for name in ("identity", "limits", "slew")}
        assert "stands at 150 V" in refused(holder, do="arm", **confirmed)
        assert controller.voltage == 150.0


def test_a_voltage_outside_the_limits_is_refused_before_it_moves(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address)
        holder.arm()
        before = len(holder.errors_sent())
        play(holder, triangle(tmp_path, highest=101.0))
        assert "10 to 100.99 V, but" in answered(holder, before + 1)[-1]
        # A machine that stands still for as long as a heartbeat disarms. An armed rig would be busy with a second time.
        if holder.state["status"] != "armed":
            holder.arm()
        play(holder, tmp_path / "no such file.csv")
        assert "no such file" in answered(holder, before + 2)[-1]
        assert holder.state["status"] == "armed"
        assert not controller.put_out()[1].any()


def test_the_plan_is_that_of_the_command(simulated):
    simulated.send(do="plan", given={**RIG, "frequency": 5, "rounds": 1, "goal": 0.5})
    simulated.until(lambda: simulated.state["plan"])
    with open_rig("sim://play", limits=LIMITS, slew_rate=2000.0) as rig:
        expected = entries(rig, Plan(frequency=5.0, rounds=1, goal=0.5))
    assert simulated.state["plan"]["steps"] == json.loads(json.dumps(expected))
    assert simulated.state["plan"]["seconds"] == sum(entry.get("seconds", 0) for entry in expected)
    for wrong in ({"rounds": 1.5}, {"frequency": -1}):
        assert next(iter(wrong)) in refused(simulated, do="plan", given={**RIG, **wrong})


def test_a_wave_is_played_and_recorded_and_the_rig_stays_armed(simulated, tmp_path):
    simulated.arm()
    play(simulated, triangle(tmp_path, seconds=2.0))
    simulated.until(lambda: simulated.state.get("result"))
    assert simulated.state["result"] == {"kind": "record", "file": str(tmp_path / "wave.h5"), "samples": 2001}
    assert simulated.state["status"] == "armed"
    record = read(tmp_path / "wave.h5")
    assert len(record) == 2001
    assert record.meta["complete"] is True
    assert record.meta["identity"].startswith("simulated play")


def test_a_record_that_is_there_is_not_replaced(simulated, tmp_path):
    simulated.arm()
    (tmp_path / "wave.h5").write_bytes(b"mine")
    play(simulated, triangle(tmp_path, seconds=2.0))
    assert "no record is overwritten" in answered(simulated, 1)[0]
    assert (tmp_path / "wave.h5").read_bytes() == b"mine"


def test_while_a_wave_plays_other_commands_are_refused(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address)
        holder.arm()
        holder.play()
        for do in ("play", "calibrate", "connect", "arm", "plan"):
            assert "busy (play)" in refused(holder, do=do)
        assert holder.state["status"] == "playing"


def test_live_data_come_ten_times_a_second_thinned_with_what_is_wanted(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:

        def lives():
            """Live data of the wave; what was read at rest, just before it, belongs to no step."""
            return [one for one in holder.messages if one["kind"] == "live" and one["step"] is not None]

        holder.connect(controller.address)
        holder.arm()
        began = time.monotonic()
        holder.play()
        holder.until(lambda: len(lives()) >= 10)
        live = lives()
        assert len(live) <= 12 * (time.monotonic() - began) + 2
        assert all(one["status"] == "playing" for one in live)
        assert all(len(one["t"]) == len(one["v"]) == len(one["y"]) == len(one["expected"]) <= 200 for one in live)
        assert {one["step"] for one in live} == {"triangle-9-90"}
        shares = [one["share"] for one in live]
        assert shares == sorted(shares)
        assert 0 < shares[-1] < 1


def test_a_pipe_that_nobody_reads_does_not_hold_up_the_wave(tmp_path):
    """Signs of life go on; live data fill the pipe; then the pipe is closed, and the voltage is brought back."""
    with ObservedController() as controller, held(tmp_path) as holder:
        fcntl.fcntl(holder.process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        holder.connect(controller.address)
        holder.arm()
        holder.deafen()
        play(holder, triangle(tmp_path, seconds=3.0))
        assert controller.wait_for(lambda: controller.told == 3001)
        assert controller.wait_for(lambda: on_disk(tmp_path) == 3001)
        away = controller.voltage
        assert away > 1.0
        play(holder, triangle(tmp_path), "second")
        assert controller.wait_for(lambda: controller.told > 4000)
        lost = time.monotonic()
        holder.process.stdin.close()
        assert controller.wait_for(holder.gone, 10.0)
        assert controller.safe_at() - lost < 10.0
        assert on_disk(tmp_path, "second") == controller.told - 3001


@pytest.mark.nightly
def test_a_reader_that_closes_the_pipe_does_not_hold_up_the_wave(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address)
        holder.arm()
        holder.deafen()
        holder.process.stdout.close()
        play(holder, triangle(tmp_path, seconds=2.0))
        assert controller.wait_for(lambda: controller.told == 2001)
        assert controller.wait_for(lambda: on_disk(tmp_path) == 2001)
        holder.alive(False)
        assert controller.wait_for(lambda: abs(controller.voltage) < 1e-9)


def test_a_calibration_without_signs_of_life_stops_and_keeps_its_samples(tmp_path):
    with ObservedController() as controller, held(tmp_path) as holder:
        holder.connect(controller.address, slew=2000.0)
        holder.arm()
        holder.send(do="calibrate", given=calibration(tmp_path))
        holder.until(lambda: holder.state.get("step") == "look" and controller.told > 300)
        assert holder.state["status"] == "calibrating"
        lost = time.monotonic()
        holder.alive(False)
        holder.until(lambda: holder.state["status"] == "connected")
        assert holder.state["words"][0] == "Stopped: the page gave no sign of life for 0.6 s."
        assert controller.safe_at() - lost < 10.0
        record = read(tmp_path / "out" / "records" / "look.h5")
        assert len(record) == controller.told
        assert record.meta["complete"] is False


def test_a_stop_while_a_calibration_computes_ends_it(simulated, tmp_path):
    simulated.arm()
    simulated.send(do="calibrate", given=calibration(tmp_path))
    simulated.until(lambda: simulated.state.get("step") == "identify")
    pressed = time.monotonic()
    assert simulated.press() == 200
    simulated.until(lambda: simulated.state["status"] == "connected")
    assert time.monotonic() - pressed < 10.0
    assert simulated.state["words"][0] == "Stopped: the emergency stop was pressed."
    assert not (tmp_path / "out" / "model.json").exists()


@pytest.mark.slow
def test_a_calibration_writes_what_the_command_writes(simulated, tmp_path):
    simulated.arm()
    bounds = {"limits": [list(LIMITS)], "slew_rate": [2000.0]}
    simulated.send(do="calibrate", given=calibration(tmp_path, rounds=1, **bounds))
    simulated.until(lambda: simulated.state.get("result"), 300.0)
    result = simulated.state["result"]
    assert result["kind"] == "calibrate"
    assert result["good"] is True
    assert result["compensated"]["largest_percent"] < result["nominal"]["largest_percent"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"records", "campaign.json", "model.json", "model.npz", "calibration.json", "report.html"}
    assert "calibrate sim://play" in (tmp_path / "out" / "report.html").read_text()
    words = {"--limits", "0", "100", "--slew-rate", "2000", "--frequency", "5", '{"rounds": 1}'}
    assert words <= {*shlex.split(result["command"])}
    assert simulated.state["status"] == "armed"


def test_a_folder_with_results_of_others_is_refused(simulated, tmp_path):
    simulated.arm()
    (tmp_path / "model.json").write_text("{}")
    assert "model.json: is there already" in refused(simulated, do="calibrate", given={**RIG, "output": str(tmp_path)})
    assert simulated.state["status"] == "armed"


def test_a_driver_that_prints_does_not_break_the_protocol(holder, tmp_path):
    (tmp_path / "loud.py").write_text(
        "from dehyst.instruments import open_rig\n"
        "def make(**options):\n"
        '    print(\'{"kind": "live"}\' * 1000)\n'
        "    return open_rig('sim://play', **options)\n"
    )
    holder.connect(f"{tmp_path / 'loud.py'}:make", slew=1000.0)
    assert holder.state["status"] == "connected"
    assert not [one for one in holder.messages if one["kind"] == "live" and "v" not in one]


def test_a_driver_that_fails_at_rest_disarms(holder, tmp_path):
    (tmp_path / "moody.py").write_text(
        "from pathlib import Path\n"
        "from dehyst.instruments.simulated import SimulatedRig\n"
        "from dehyst.virtual import PlayActuator\n"
        "class Moody(SimulatedRig):\n"
        "    def _read(self):\n"
        "        if Path(__file__).with_name('moody').exists():\n"
        "            raise SystemExit('no more')\n"
        "        return super()._read()\n"
        "def make(**options):\n"
        "    return Moody(PlayActuator(), **options)\n"
    )
    holder.connect(f"{tmp_path / 'moody.py'}:make", slew=1000.0)
    holder.arm()
    (tmp_path / "moody").touch()
    holder.until(lambda: holder.state["status"] in ("lost", "connected"))
    words = " ".join(holder.state["words"])
    assert re.match("Stopped: .* simulated PlayActuator: _read .* SystemExit: no more", words)
    assert holder.state["status"] == "lost"
    assert words.count("by hand") == 1


def test_a_driver_that_holds_pythons_lock_is_not_held_against_the_page(holder, tmp_path):
    """No thread runs meanwhile; the signs of life that came are read before the watchdog judges."""
    (tmp_path / "selfish.py").write_text(
        "import ctypes\n"
        "from pathlib import Path\n"
        "from dehyst.instruments.simulated import SimulatedRig\n"
        "from dehyst.virtual import PlayActuator\n"
        "class Selfish(SimulatedRig):\n"
        "    def _read(self):\n"
        "        if (flag := Path(__file__).with_name('hold')).exists():\n"
        "            flag.unlink()\n"
        "            ctypes.PyDLL(None).usleep(1_000_000)\n"
        "        return super()._read()\n"
        "def make(**options):\n"
        "    return Selfish(PlayActuator(), **options)\n"
    )
    holder.connect(f"{tmp_path / 'selfish.py'}:make", slew=1000.0)
    holder.arm()
    (tmp_path / "hold").touch()
    began = time.monotonic()
    holder.until(lambda: time.monotonic() > began + 2.0)
    assert not (tmp_path / "hold").exists()
    assert holder.state["status"] == "armed"
    (tmp_path / "hold").touch()
    holder.alive(False)
    holder.until(lambda: holder.state["status"] == "connected", 5.0)


def test_a_record_is_that_of_the_voltage(simulated, tmp_path):
    simulated.arm()
    file = triangle(tmp_path, seconds=1.0)
    play(simulated, file)
    simulated.until(lambda: simulated.state.get("result"))
    wanted = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1]
    assert np.abs(read(tmp_path / "wave.h5").voltage - wanted).max() < 1e-9
