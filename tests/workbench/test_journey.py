"""From a record to a voltage and an export, by requests as the page sends them; and the script does the same again."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from command_line import run_as_process
from workbench_client import done, entry, held, served, until, upload, workers

from dehyst import Actuator, read
from dehyst.model import voltages_of
from dehyst.records import read_table

CORNERS = [[0.0, 2.0], [0.5, 9.0], [1.0, 3.0]]
DRAWN = {"points": CORNERS, "low": 0, "high": 100, "rate": 1000}
SCAN = {"kind": "triangle", "low": 3, "high": 7, "frequency": 5}


def floats(answer, columns):
    assert answer.status_code == 200, answer.text
    return np.frombuffer(answer.content, "<f4").reshape(columns, -1).astype(float)


def identified(client, records, **request):
    answer = client.post("/api/models", json={"train": records, **request})
    assert answer.status_code == 200, answer.text
    key = answer.json()["id"]
    state = until(client, lambda state: entry(state, "models", key)["status"] != "identifying")
    return entry(state, "models", key)


@pytest.fixture(scope="module")
def visited(tmp_path_factory, loops):
    """A workbench after the whole journey: its folder, its last state, and what was asked for on the way."""
    folder = tmp_path_factory.mktemp("journey") / "bench"
    with served(folder) as running, running.client() as client:
        record = upload(client, loops)
        model = identified(client, [record["id"]], options={"structure": "maxwell_slip", "name": "my stage"})
        base = f"/api/models/{model['id']}"
        path = done(client, client.post(f"{base}/follow", json=DRAWN))
        done(client, client.post(f"{base}/follow", json={"scan": SCAN, "rate": 1000}))
        exports = {kind: done(client, client.post(f"{base}/export", json={"kind": kind}))[0] for kind in ("c", "fmu")}
        assessed = done(client, client.post(f"{base}/insight", json={}))[1]
        answers = {
            "record": floats(client.get(f"/api/records/{record['id']}/data"), 3),
            "folder": client.get("/files/exports/my-stage-c"),
            "report": client.get("/files/reports/my-stage.html"),
        }
        yield folder, assessed, {"record": record, "model": model, "path": path[0], "exports": exports}, answers


def test_a_record_has_the_samples_of_its_file(visited, loops):
    _, _, entries, answers = visited
    record = read(loops)
    assert (entries["record"]["status"], entries["record"]["samples"]) == ("ready", len(record))
    assert entries["record"]["rate_hz"] == pytest.approx(500)
    columns = record.time, record.voltage, record.displacement * 1e6
    np.testing.assert_allclose(answers["record"], columns, rtol=1e-6, atol=1e-6)


def test_a_model_has_a_verdict_and_a_range(visited):
    folder, _, entries, _ = visited
    model = entries["model"]
    assert (model["status"], model["verdict"]["readiness"]) == ("ready", "READY")
    assert model["verdict"]["largest_percent"] < 1
    actuator = Actuator.load(folder / model["file"])
    assert not model["timed"] and model["fastest_v_per_s"] == actuator.identification.validity.speeds[1]
    assert model["range_v"] == list(voltages_of(actuator))
    assert model["range_um"] == [1e6 * end for end in actuator.reach]


def test_a_voltage_follows_the_path_within_the_limits(visited):
    folder, state, entries, _ = visited
    assert entries["path"]["status"] == "done"
    voltage = state["voltages"][0]
    assert 0 <= voltage["range_v"][0] < voltage["range_v"][1] <= 100
    assert any("home" in words for words in voltage["words"])
    assert voltage["asked"] == DRAWN
    assert 0 < voltage["promises"][0]["largest_percent"] < 1 and voltage["name"] == "my-stage-path"
    assert state["voltages"][1]["asked"] == {"scan": SCAN, "rate": 1000} and "triangle" in state["voltages"][1]["file"]
    table = read_table(folder / voltage["file"])
    volts = {column.name: column.data for column in table.columns}
    assert volts["voltage_V"].size == voltage["samples"]
    assert np.ptp(volts["time_s"]) == pytest.approx(voltage["seconds"])
    path = volts["displacement_um"][volts["phase"] == 2]
    corners = np.array(CORNERS)
    np.testing.assert_allclose(path, np.interp(np.arange(path.size) * 1e-3, *corners.T), atol=1e-6)


def test_exports_are_made(visited):
    folder, state, entries, answers = visited
    assert {kind: job["status"] for kind, job in entries["exports"].items()} == dict.fromkeys(("c", "fmu"), "done")
    assert {"piezo.c", "piezo.h"} <= {path.name for path in (folder / "exports" / "my-stage-c").iterdir()}
    assert answers["folder"].status_code == 400
    listed = {file["path"] for file in state["files"]}
    assert {"models/my-stage.json", "exports/my-stage.fmu", "commands.sh"} <= listed
    assert all((folder / path).exists() for path in listed)


def test_a_report_is_shown_without_the_permissions_of_the_page(visited):
    *_, answers = visited
    headers = answers["report"].headers
    assert headers["content-type"].startswith("text/html")
    policy = headers["content-security-policy"]
    assert policy.startswith("sandbox") and "allow-same-origin" not in policy


def test_an_assessment_is_a_report_of_the_folder(visited):
    folder, state, *_ = visited
    report = (folder / state["models"][0]["insight"]["report"]).read_text()
    assert all(words in report for words in ("Where the records turned", "To record next</h2>\n<p"))


@pytest.mark.nightly
def test_the_script_makes_the_same_files_again(visited, tmp_path):
    folder, state, *_ = visited
    shutil.copytree(folder / "uploads", tmp_path / "again" / "uploads")
    # A path that was drawn is an input too, and the script says so.
    assert "uploads/ and paths/" in "".join((folder / "commands.sh").read_text().splitlines(keepends=True)[:2])
    shutil.copytree(folder / "paths", tmp_path / "again" / "paths")
    # An assessment and exports make no file that is compared here.
    lines = (folder / "commands.sh").read_text().splitlines(keepends=True)
    script = "".join(line for line in lines if not line.startswith(("dehyst insight", "dehyst export")))
    (tmp_path / "again" / "commands.sh").write_text(script)
    program = tmp_path / "bin" / "dehyst"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\nexec {sys.executable} -c 'from dehyst.cli import main; main()' \"$@\"\n")
    program.chmod(0o755)
    own = {"cwd": tmp_path / "again", "env": os.environ | {"PATH": f"{program.parent}:/usr/bin:/bin"}}
    ended = subprocess.run(["sh", "commands.sh"], **own, check=False, capture_output=True, text=True)
    assert ended.returncode in (0, 1), ended.stderr
    for file in state["files"]:
        if file["kind"] in ("record", "voltage") or file["path"] == "models/my-stage.json":
            first, second = ((place / file["path"]).read_bytes() for place in (folder, tmp_path / "again"))
            assert first == second, file["path"]


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    status, _, err = run_as_process("workbench", tmp_path, "--no-browser")
    assert status == 2 and "files (thesis.tex)" in err


def test_after_the_end_no_process_runs_and_the_session_is_saved(tmp_path, loops):
    folder, records, model = tmp_path / "bench", [], None
    for number in (signal.SIGTERM, signal.SIGKILL, None):
        with served(folder) as running, running.client() as client:
            state = client.get("/api/state").json()
            assert state["records"] == records
            ends = [own["status"] for own in state["models"]]
            assert ends == ["ready", "cancelled", "cancelled"][: len(ends)]
            if number is None:
                break
            records.append(upload(client, loops))
            train = [records[-1]["id"]]
            model = model or identified(client, train, options={"structure": "maxwell_slip"})
            assert client.get("/api/state").json()["models"][0]["verdict"] == model["verdict"]
            key = client.post("/api/models", json={"train": train}).json()["id"]
            with held(folder):
                assert entry(client.get("/api/state").json(), "models", key)["status"] == "identifying"
                # Nobody else uses the folder meanwhile, and what is known is written in the background.
                status, _, err = run_as_process("workbench", folder, "--no-browser", "--port", "0")
                assert status == 2 and "workbench uses" in err
            running.process.send_signal(number)
            running.process.wait(20)
        deadline = time.monotonic() + 20
        while workers(folder) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert workers(folder) == []
    assert len({record["id"] for record in records}) == 2
