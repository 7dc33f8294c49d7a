"""What the server answers to requests about a rig: one at a time, and only what the rig's process confirms."""

import os
import signal
import threading
import time

import pytest
from observed_rig import LIMITS, SLEW, ObservedController, children, triangle
from workbench_client import alive, served, until

from examples import at_night

PROCESS = "dehyst.workbench.rig.process"


@pytest.fixture
def controller():
    with ObservedController() as running:
        yield running


@pytest.fixture
def page(bench):
    """A page that gives signs of life, as the watchdog demands."""
    with bench.client() as client, alive(bench, client):
        yield client


def asked(client, what, **body):
    return client.post(f"/api/rig/{what}", json=body)


def connected(client, controller):
    answer = asked(client, "connect", address=controller.address, limits=list(LIMITS), slew=SLEW)
    assert answer.status_code == 200, answer.text
    return until(client, lambda state: state["rig"]["status"] == "connected")["rig"]


def armed(client, controller):
    rig = connected(client, controller)
    answer = asked(client, "arm", **{name: rig[name] for name in ("identity", "limits", "slew")})
    assert answer.status_code == 200, answer.text
    return rig


def playing(bench, client):
    """Play a triangle; return the name of its file."""
    wave = triangle(bench.folder / "voltages")
    assert asked(client, "play", file=f"voltages/{wave.name}").status_code == 200
    until(client, lambda state: state["rig"]["status"] == "playing")
    return wave.name


@pytest.mark.parametrize("gap", [at_night(0.0), 0.005, at_night(0.02)])
def test_of_two_connects_one_is_refused_and_there_is_one_process(bench, page, controller, gap):
    answers = []

    def connect(name):
        answers.append(asked(page, "connect", address=name, limits=list(LIMITS), slew=SLEW).status_code)

    both = [threading.Thread(target=connect, args=(name,)) for name in (controller.address, "sim://play")]
    for one in both:
        one.start()
        time.sleep(gap)
    for one in both:
        one.join()
    assert sorted(answers) == [200, 400]
    until(page, lambda state: state["rig"]["status"] == "connected")
    assert len(children(bench.process.pid, PROCESS)) == 1


def test_while_one_plays_nothing_else_is_begun(bench, page, controller):
    armed(page, controller)
    wave = triangle(bench.folder / "voltages")
    answers = []
    presses = [
        threading.Thread(
            target=lambda: answers.append(asked(page, "play", file=f"voltages/{wave.name}").status_code), daemon=True
        )
        for _ in range(3)
    ]
    for press in presses:
        press.start()
    for press in presses:
        press.join()
    assert sorted(answers) == [200, 400, 400]
    until(page, lambda state: state["rig"]["status"] == "playing")
    for what in ("play", "calibrate", "plan", "connect", "arm"):
        refused = asked(page, what, file=f"voltages/{wave.name}", address="sim://play", limits=list(LIMITS), slew=SLEW)
        assert refused.status_code == 400
    assert controller.wait_for(lambda: controller.told > 300)
    assert asked(page, "stop").status_code == 200
    state = until(page, lambda state: state["rig"]["status"] == "connected" and state["records"])
    assert [record["name"] for record in state["records"]] == [f"{wave.name[:-4]}-played"]
    assert sum("played on" in line for line in state["log"]) == 1


@pytest.mark.nightly
def test_a_stop_is_answered_as_the_process_confirms(bench, page, controller):
    armed(page, controller)
    playing(bench, page)
    assert asked(page, "stop").status_code == 200
    until(page, lambda state: state["rig"]["status"] == "connected")
    assert asked(page, "stop").status_code == 409
    assert controller.wait_for(lambda: controller.voltage == 0.0)


def test_arming_demands_the_identity_that_is_connected(page, controller):
    rig = connected(page, controller)
    assert rig["identity"] == controller.identity
    confirmed = {name: rig[name] for name in ("limits", "slew")}
    for identity in (None, "", "another", rig["identity"] + " "):
        refused = asked(page, "arm", identity=identity, **confirmed)
        assert refused.status_code == 400
        assert "rig" in refused.json()["error"]
    assert page.get("/api/state").json()["rig"]["status"] == "connected"


def test_a_process_that_is_silent_is_named_and_stops_nothing(bench, page, controller):
    armed(page, controller)
    playing(bench, page)
    (process,) = children(bench.process.pid, PROCESS)
    os.kill(process, signal.SIGSTOP)
    try:
        until(page, lambda state: (state["rig"]["silent"] or 0) >= 1)
        refused = asked(page, "stop")
        assert refused.status_code == 504
        assert "no answer" in refused.json()["error"]
    finally:
        os.kill(process, signal.SIGCONT)
    state = until(page, lambda state: state["rig"]["status"] == "connected" and state["rig"]["silent"] is None)
    assert "Stopped" in state["rig"]["words"][0]
    assert controller.wait_for(lambda: controller.voltage == 0.0)


@pytest.mark.nightly
def test_the_journal_of_a_killed_process_becomes_a_record(bench, page, controller):
    armed(page, controller)
    wave = playing(bench, page)
    journal = bench.folder / "records" / f"{wave[:-4]}-played.h5.part.csv"
    controller.wait_for(lambda: journal.exists() and journal.stat().st_size > 10_000)
    (process,) = children(bench.process.pid, PROCESS)
    os.kill(process, signal.SIGKILL)
    state = until(page, lambda state: [one for one in state["records"] if one["status"] == "ready"])
    assert [record["source"] for record in state["records"]] == [f"records/{wave[:-4]}-played.h5"]
    assert state["records"][0]["samples"] > 100
    assert not journal.exists()
    # The same rig can be connected again.
    until(page, lambda state: state["rig"]["status"] == "none")
    connected(page, controller)


def test_a_journal_that_a_killed_workbench_left_is_listed_at_the_next_start(tmp_path):
    folder = tmp_path / "bench"
    with served(folder):
        pass
    with ObservedController() as controller, served(folder) as bench, bench.client() as client, alive(bench, client):
        armed(client, controller)
        wave = playing(bench, client)
        journal = folder / "records" / f"{wave[:-4]}-played.h5.part.csv"
        controller.wait_for(lambda: journal.exists() and journal.stat().st_size > 10_000)
        head = journal.read_bytes()
        bench.process.kill()
        controller.wait_for(lambda: not journal.exists())
    (folder / "records" / "left.h5.part.csv").write_bytes(head)
    with served(folder) as bench, bench.client() as client:
        state = until(client, lambda state: [one for one in state["records"] if one["status"] == "ready"])
        assert [record["source"] for record in state["records"]] == ["records/left.h5"]


@pytest.mark.parametrize(
    ("limits", "slew"),
    [at_night([0.0, 100.0], 1e-300), ([0.0, 100.0], 0.027), at_night([0.0, 1e-320], 1.0), ([0.0, 1e-4], 1.0)],
)
def test_limits_and_slew_rates_whose_ramp_never_ends_are_refused(page, limits, slew):
    assert asked(page, "connect", address="sim://play", limits=limits, slew=slew).status_code == 200
    state = until(page, lambda state: state["rig"]["error"])
    assert state["rig"]["status"] == "none"


def test_a_plan_with_impossible_numbers_is_refused(page):
    assert asked(page, "connect", address="sim://play", limits=[0, 100], slew=1000).status_code == 200
    until(page, lambda state: state["rig"]["status"] == "connected")
    for plan in ({"frequency": 0}, {"goal": 0}, {"frequency": None}, {"goal": -1}):
        for what in ("plan", "calibrate"):
            refused = asked(page, what, **plan)
            assert refused.status_code == 400
            assert next(iter(plan)) in refused.json()["error"]
    assert asked(page, "plan", frequency=5).status_code == 200
    assert page.get("/api/state").json()["rig"]["plan"]["seconds"] > 0
