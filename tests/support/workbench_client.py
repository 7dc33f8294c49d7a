"""A workbench in its own process, and a client of its page."""

import os
import re
import signal
import subprocess
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
from command_line import DEHYST, TIMEOUT

LINK = re.compile(r"(http://127\.0\.0\.1:(\d+))/\?token=(\S+)")
# Seconds between two readings of the state.
_LOOK = 0.05


class Served:
    """A running workbench: its `folder`, `base` address, `port`, `link` and `process`."""

    def __init__(self, process, folder):
        self.process, self.folder = process, folder
        while line := process.stdout.readline():
            if match := LINK.search(line):
                self.link, self.base, self.port = match[0], match[1], int(match[2])
                return
        raise AssertionError(process.stderr.read())

    @contextmanager
    def client(self):
        """Open a client that has the cookie, as the page has."""
        headers = {"Origin": self.base}
        with httpx.Client(base_url=self.base, headers=headers, timeout=60, follow_redirects=True) as client:
            assert client.get(self.link).status_code == 200
            yield client


@contextmanager
def served(folder, *options, browser=None):
    """Serve a workbench; `browser`: a program that opens the page."""
    page = ["--no-browser"] if browser is None else []
    process = subprocess.Popen(
        [*DEHYST, "workbench", str(folder), *page, "--port", "0", *options],
        env={**os.environ, "BROWSER": browser or ""},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield Served(process, folder)
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        finally:
            process.stdout.close()
            process.stderr.close()


def until(client, condition):
    """Return the state once a condition of it holds."""
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        state = client.get("/api/state").json()
        if condition(state):
            return state
        time.sleep(_LOOK)
    raise AssertionError(f"not within {TIMEOUT} s: {state}")


def entry(state, kind, key):
    """Return an entry of a state."""
    return next(entry for entry in state[kind] if entry["id"] == key)


def upload(client, path, name=None):
    """Upload a file; return its entry once it is read or refused."""
    answer = client.put("/api/records", params={"name": name or path.name}, content=path.read_bytes())
    assert answer.status_code == 200, answer.text
    key = answer.json()["id"]
    state = until(client, lambda state: entry(state, "records", key)["status"] != "reading")
    return entry(state, "records", key)


def done(client, answer):
    """Wait for the job that an answer names; return its entry and the state."""
    assert answer.status_code == 200, answer.text
    key = answer.json()["job"]
    state = until(client, lambda state: entry(state, "jobs", key)["status"] != "running")
    return entry(state, "jobs", key), state


def workers(folder):
    """Return the numbers of the processes that run an operation in a folder."""
    numbers = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            runs = b"dehyst.workbench.worker" in (place / "cmdline").read_bytes()
            numbers += [int(place.name)] * (runs and (place / "cwd").readlink() == folder.resolve())
    return numbers


@contextmanager
def held(folder):
    """Stop the worker of a folder as soon as it exists."""
    deadline = time.monotonic() + TIMEOUT
    while not (numbers := workers(folder)):
        assert time.monotonic() < deadline, "no worker was started"
        time.sleep(_LOOK)
    for number in numbers:
        os.kill(number, signal.SIGSTOP)
    try:
        yield
    finally:
        for number in workers(folder):
            os.kill(number, signal.SIGCONT)
