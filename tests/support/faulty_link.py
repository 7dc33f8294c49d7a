"""A pipe between a client and a controller in one process; it changes replies."""

import random
import time

from dehyst.instruments.gcs_client import TcpLink
from dehyst.instruments.pi import PiRig

KINDS = ("drop", "truncate", "garble", "replay", "inject", "double", "delay", "number", "nonsense", "close", "space")
_LIES = ["nan", "inf", "1e999", "-1e300", "1000000", "-99999", "", "1=2=3", "0x10", "--1", "1,5", "\u00b5"]


class Meddling:
    """Changes each reply with a probability by one of `KINDS`, and counts the changes.

    `number` replaces a number by another kind of number: then the reply is no longer valid.
    """

    def __init__(self, seed, share, kinds=KINDS):
        self.rng, self.share, self.kinds = random.Random(seed), share, kinds
        self.count = 0
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
        return getattr(self, f"_{self.rng.choice(self.kinds)}")(reply)

    def _drop(self, reply):
        return b""

    def _truncate(self, reply):
        return reply[: self.rng.randrange(len(reply))]

    def _garble(self, reply):
        spoiled = bytearray(reply)
        for _ in range(self.rng.randint(1, 4)):
            spoiled[self.rng.randrange(len(spoiled))] = self.rng.randrange(256)
        return bytes(spoiled)

    def _replay(self, reply):
        return self.rng.choice(self.past)

    def _inject(self, reply):
        extra = self.rng.choice([b"\n", b"0\n", b"1=7\n", b" \n", b"HTTP/1.1 400\r\n", self.rng.choice(self.past)])
        return extra + reply if self.rng.random() < 0.5 else reply + extra

    def _double(self, reply):
        return reply + reply

    def _delay(self, reply):
        self.late = reply
        return b""

    def _number(self, reply):
        head, equals, tail = reply.partition(b"=")
        lie = self.rng.choice([*_LIES, repr(self.rng.uniform(-300, 300)), str(self.rng.randint(-5, 500))]).encode()
        if not equals:
            return lie + b"\n"
        _, newline, rest = tail.partition(b"\n")
        return head + equals + lie + newline + rest

    def _nonsense(self, reply):
        return self.rng.randbytes(self.rng.randint(1, 200)) + self.rng.choice([b"", b"\n"])

    def _close(self, reply):
        return None

    def _space(self, reply):
        return reply.replace(b"\n", b" \n") if self.rng.random() < 0.5 else reply.replace(b" \n", b"\n")


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
