"""Two connects at once, then the emergency stop, with the server and while it hangs: the device's own log."""

import os
import signal
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from observed_rig import LIMITS, SLEW, ObservedController, asked, children, triangle

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from workbench_client import alive, served, until

PROCESS = "dehyst.workbench.rig.process"
# Most seconds between two connects; range / slew rate and a second, and what a busy machine takes beside.
GAP, SAFE, BUSY = 0.02, 2.0, 2.0


class Trials:
    """A workbench that is connected twice at once, armed, and stopped by its emergency stop, again and again.

    `connects`, `refused`: number of tries, and in how many exactly one connect was refused. `most_processes`: of the
    rig at any time. `presses`, `effective`: presses of the stop, running server first and hung server second, and how
    many were confirmed, were the first reason to stop, and brought the voltage to 0 V. `seconds`: from each press to
    the safe voltage. `answers`: seconds from each press to its answer. `failures`: what was observed at other presses.
    `disarmed`: how often the watchdog disarmed the rig before the wave began.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.connects, self.refused, self.most_processes = 0, 0, 0
        self.presses, self.effective = [0, 0], [0, 0]
        self.seconds: list[float] = []
        self.answers: list[float] = []
        self.failures: list[dict] = []
        self.disarmed = 0
        self._controller = stack.enter_context(ObservedController())
        self._bench = stack.enter_context(served(folder / "bench"))
        stack.callback(self._bench.process.send_signal, signal.SIGCONT)
        self._client = stack.enter_context(self._bench.client())
        stack.enter_context(alive(self._bench, self._client))
        self._wave = triangle(self._bench.folder / "voltages").name

    def connect(self, gap: float) -> None:
        """Connect twice, `gap` [s] apart, the second time to another rig; if that one came first, connect again."""
        answers: list[int] = []
        both = [
            threading.Thread(target=self._asked, args=("connect", answers), kwargs={"address": address})
            for address in (self._controller.address, "sim://play")
        ]
        for k, one in enumerate(both):
            time.sleep(k * gap)
            one.start()
        for one in both:
            one.join()
        self._until("connected")
        self.connects += 1
        self.refused += sorted(answers) == [200, 400]
        self.most_processes = max(self.most_processes, len(self._processes()))
        if self._rig()["address"] != self._controller.address:
            self.end()
            self._asked("connect", [], address=self._controller.address)
            self._until("connected")

    def stop(self, *, hung: bool) -> None:
        """Arm, play, and press the emergency stop at some time of the wave, once."""
        rig = self._rig()
        # On a busy machine the signs of life of this page may come too late, and the watchdog disarms.
        while not self._plays(rig["identity"]):
            self.disarmed += 1
        told = self._controller.told + 100 + 10 * (sum(self.presses) % 60)
        self._controller.wait_for(lambda: self._controller.told > told)
        if hung:
            self._bench.process.send_signal(signal.SIGSTOP)
        port, key = rig["stop"]["port"], rig["stop"]["key"]
        headers = {"Host": f"127.0.0.1:{port}", "Origin": self._bench.base, "X-Dehyst-Stop": key}
        pressed = time.monotonic()
        status, _ = asked(port, "POST /stop HTTP/1.1", headers)
        self.answers.append(time.monotonic() - pressed)
        self._controller.wait_for(lambda: self._controller.voltage == 0.0, SAFE + BUSY)
        safe = self._controller.safe_at()
        if hung:
            self._bench.process.send_signal(signal.SIGCONT)
        self._until("connected")
        words = self._rig()["words"]
        first = "emergency stop" in " ".join(words[:1])
        self.presses[hung] += 1
        self.effective[hung] += status == 200 and first and safe is not None
        if not (status == 200 and first and safe is not None):
            self.failures.append({"hung": hung, "status": status, "words": words, "answer_seconds": self.answers[-1]})
        self.seconds.append(float("inf") if safe is None else safe - pressed)
        self._controller.forget()
        # Reading the records would only take time.
        for record in self._client.get("/api/state").json()["records"]:
            self._client.delete(f"/api/records/{record['id']}")

    def end(self) -> None:
        """End the rig's process, so that the next connect starts one."""
        for process in self._processes():
            os.kill(process, signal.SIGTERM)
        self._controller.wait_for(lambda: not self._processes())
        self._until("none")

    def summary(self) -> dict:
        """Return the JSON values."""
        return {
            "connects": self.connects,
            "one_refused": self.refused,
            "most_processes": self.most_processes,
            "presses": dict(zip(("server_runs", "server_hangs"), self.presses, strict=True)),
            "effective": dict(zip(("server_runs", "server_hangs"), self.effective, strict=True)),
            "failures": self.failures,
            "disarmed_before": self.disarmed,
            "worst_seconds_to_safe": round(max(self.seconds), 3),
            "median_seconds_to_answer": round(float(np.median(self.answers)), 3),
            "worst_seconds_to_answer": round(max(self.answers), 3),
        }

    def _asked(self, what: str, answers: list[int], **body: object) -> None:
        body = {"limits": list(LIMITS), "slew": SLEW, **body}
        answers.append(self._client.post(f"/api/rig/{what}", json=body).status_code)

    def _plays(self, identity: str) -> bool:
        """Arm and play; return whether the wave has begun."""
        answers: list[int] = []
        self._asked("arm", answers, identity=identity)
        self._asked("play", answers, file=f"voltages/{self._wave}")
        return answers == [200, 200] and self._controller.wait_for(lambda: self._rig()["status"] == "playing", 5.0)

    def _rig(self) -> dict:
        return self._client.get("/api/state").json()["rig"]

    def _until(self, status: str) -> None:
        until(self._client, lambda state: state["rig"]["status"] == status)

    def _processes(self) -> list[int]:
        return children(self._bench.process.pid, PROCESS)


def rehearse_stops(tries: int) -> dict:
    """Try this often: two connects, then a stop with the server and one while it hangs; return the JSON values."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        trials = Trials(Path(folder), stack)
        for k in range(tries):
            trials.connect(GAP * k / max(1, tries - 1))
            for hung in (False, True):
                trials.stop(hung=hung)
            trials.end()
            if k % 10 == 9:
                print(trials.summary(), flush=True)
        return trials.summary()
