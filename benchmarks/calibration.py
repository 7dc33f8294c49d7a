"""The whole experiment over a socket: an emulated controller and `dehyst calibrate`, two processes.

Writes `calibration.json`: the measured errors along a path, and seconds from start to end.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

OUTPUT = Path(__file__).parent / "calibration.json"
SERVE = Path(__file__).parents[1] / "tests" / "support" / "serve_emulator.py"
DEHYST = Path(sys.executable).parent / "dehyst"
# Actuator, link, and speed of the instrument's clock: an instrument with creep runs faster.
CASES = (("play", "pi", 1), ("play", "epics", 1), ("preisach", "pi", 1), ("creep", "pi", 5), ("boucwen", "pi", 1))
LOCAL = {"EPICS_CA_ADDR_LIST": "127.0.0.1", "EPICS_CA_AUTO_ADDR_LIST": "NO", "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1"}
PREFIX = "BENCH"


def measure(actuator: str, link: str, speed: float) -> dict:
    """One calibration on an emulated instrument."""
    epics = ["--epics", PREFIX] if link == "epics" else []
    serve = [sys.executable, SERVE, "--port", "0", "--actuator", actuator, "--speed", str(speed), *epics]
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "serve.txt"
        with told.open("w") as output:
            server = subprocess.Popen(serve, stdout=output, env=os.environ | LOCAL)
        try:
            port = _port(told)
            rig = f"epics://{PREFIX}" if epics else f"pi://127.0.0.1:{port}"
            began = time.monotonic()
            done = subprocess.run(
                [DEHYST, "calibrate", rig, "-o", f"{folder}/out", "--json"],
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | LOCAL,
                check=False,
            )
            seconds = time.monotonic() - began
        finally:
            server.terminate()
            server.wait()
        said = told.read_text()
    found = json.loads(done.stdout)
    low, high = map(float, re.search(r"put out (\S+) to (\S+) V", said).groups())
    return {
        "actuator": actuator,
        "link": link,
        "speed": speed,
        "seconds": seconds,
        "status": done.returncode,
        "records": found["records"],
        "nominal": found["nominal"],
        "compensated": found["compensated"],
        "stroke_m": found["stroke_m"],
        "limits_V": found["limits_V"],
        "put_out_V": [low, high],
    }


def _port(told: Path) -> int:
    """Return the port that a server reports."""
    for _ in range(600):
        if found := re.search(r"pi://127\.0\.0\.1:(\d+)", told.read_text()):
            return int(found[1])
        time.sleep(0.1)
    raise RuntimeError(f"no server: {told.read_text()}")


def main() -> None:
    results = []
    print(f"{'actuator':10s}{'link':8s}{'speed':>6s}{'seconds':>9s}{'nominal %':>11s}{'compensated %':>15s}")
    for case in CASES:
        row = measure(*case)
        results.append(row)
        print(
            f"{row['actuator']:10s}{row['link']:8s}{row['speed']:6g}{row['seconds']:9.1f}"
            f"{row['nominal']['largest_percent']:11.3f}{row['compensated']['largest_percent']:15.3f}"
        )
    OUTPUT.write_text(json.dumps({"calibrations": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
