"""A workbench in a process of its own, and a client of its page."""

import re
import signal
import subprocess
import time
from contextlib import contextmanager

import httpx
from command_line import DEHYST, TIMEOUT

LINK = re.compile(r"(http://127\.0\.0\.1:(\d+))/\?token=(\S+)")
# Seconds between two looks at the state.
_LOOK = 0.05


class Served:
    """A running workbench: its `folder`, `base` address, `port`, `token` and `process`."""

    def __init__(self, process, folder, base, port, token):
        self.process, self.folder, self.base, self.port, self.token = process, folder, base, port, token
        self.link = f"{base}/?token={token}"

    @contextmanager
    def client(self):
        """Open a client that has the cookie, as the page has."""
        headers = {"Origin": self.base}
        with httpx.Client(base_url=self.base, headers=headers, timeout=60, follow_redirects=True) as client:
            assert client.get("/", params={"token": self.token}).status_code == 200
            yield client


@contextmanager
def served(folder, *options):
    process = subprocess.Popen(
        [*DEHYST, "workbench", str(folder), "--no-browser", "--port", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line = process.stdout.readline()
        match = LINK.search(line)
        assert match, line + process.stderr.read()
        yield Served(process, folder, match[1], int(match[2]), match[3])
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
    return next(one for one in state[kind] if one["id"] == key)


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
