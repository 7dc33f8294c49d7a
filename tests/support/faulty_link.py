"""A pipe between a client and a controller in one process; it changes replies."""

import random
import time

from dehyst.instruments.gcs_client import TcpLink
from dehyst.instruments.pi import PiRig

_LIES = ["nan", "inf", "1e999", "-1e300", "1000000", "-99999", "", "1=2=3", "0x10", "--1", "1,5", "\u00b5"]


def _garbled(rng, reply):
    spoiled = bytearray(reply)
    for _ in range(rng.randint(1, 4)):
        spoiled[rng.randrange(len(spoiled))] = rng.randrange(256)
    return bytes(spoiled)


def _with_another_number(rng, reply):
    """Replace a number by another kind of number: then the reply is no longer valid."""
    head, equals, tail = reply.partition(b"=")
    lie = rng.choice([*_LIES, repr(rng.uniform(-300, 300)), str(rng.randint(-5, 500))]).encode()
    return head + equals + lie + tail[tail.find(b"\n") :] if equals else lie + b"\n"


def _with_more(rng, reply, past):
    more = rng.choice([b"\n", b"0\n", b"1=7\n", b" \n", b"HTTP/1.1 400\r\n", rng.choice(past)])
    return more + reply if rng.random() < 0.5 else reply + more


# By dice, reply and earlier replies: the bytes that are passed on instead, or None to close the connection.
CHANGES = (
    lambda rng, reply, past: b"",
    lambda rng, reply, past: reply[: rng.randrange(len(reply))],
    lambda rng, reply, past: _garbled(rng, reply),
    lambda rng, reply, past: rng.choice(past),
    _with_more,
    lambda rng, reply, past: reply + reply,
    lambda rng, reply, past: _with_another_number(rng, reply),
    lambda rng, reply, past: rng.randbytes(rng.randint(1, 200)) + rng.choice([b"", b"\n"]),
    lambda rng, reply, past: None,
    lambda rng, reply, past: reply.replace(*rng.choice([(b"\n", b" \n"), (b" \n", b"\n")])),
)


class Meddling:
    """Delays each reply with a probability, or changes it by one of `CHANGES`, and counts how often."""

    def __init__(self, seed, share):
        self.rng, self.share, self.count = random.Random(seed), share, 0
        self.past, self.late = [b"0\n"], b""

    def __call__(self, reply):
        """Return the bytes to pass on instead, or None to close the connection."""
        reply, self.late = self.late + reply, b""
        if not reply:
            return reply
        self.past = [*self.past[-20:], reply]
        if self.rng.random() >= self.share:
            return reply
        self.count += 1
        if self.rng.random() < 1 / (1 + len(CHANGES)):
            self.late = reply
            return b""
        return self.rng.choice(CHANGES)(self.rng, reply, self.past)


class _Pipe:
    """The part of a socket that `TcpLink` uses, with a controller at the other end; silence raises at once."""

    def __init__(self, controller, meddle):
        self.controller, self.meddle = controller, meddle
        self.waiting, self.half, self.closed = b"", b"", False

    def settimeout(self, seconds):
        pass

    def sendall(self, data):
        if self.closed:
            raise BrokenPipeError("closed")
        *lines, self.half = (self.half + data).split(b"\n")
        for line in lines:
            reply = self.meddle((self.controller.answer(line.decode("ascii")) or "").encode())
            if reply is None:
                self.closed = True
                return
            self.waiting += reply

    def recv(self, size):
        data, self.waiting = self.waiting[:size], self.waiting[size:]
        if not data and not self.closed:
            raise TimeoutError("silent")
        return data

    def close(self):
        self.closed = True


class PipeLink(TcpLink):
    """The real link with a pipe in place of its socket, without waiting."""

    def __init__(self, controller, meddle=lambda reply: reply, timeout=0.01):
        self.controller, self.meddle = controller, meddle
        super().__init__("pipe", 1, timeout)

    def _connect(self):
        return _Pipe(self.controller, self.meddle)

    def _line(self, deadline):
        # A pipe is never slow. The machine may be slow, but that is no fault of the link.
        return super()._line(time.monotonic() + 60.0)


class QuickRig(PiRig):
    """A rig that waits by the controller's clock."""

    patience = 0.05

    def __init__(self, link, **options):
        self._controller = link.controller
        super().__init__(link, **options)

    def _now(self):
        return self._controller.clock.time

    def _wait(self, seconds):
        self._controller.clock.wait(seconds)
