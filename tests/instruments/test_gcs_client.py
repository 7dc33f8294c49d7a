"""Who is no controller, or not there, is found out at once, by a clear message."""

import socket
import threading
import time

import pytest

from dehyst.instruments import LinkError
from dehyst.instruments.gcs_client import TcpLink
from dehyst.instruments.pi import PiRig


class Ear:
    """A server for one answer, whatever is asked."""

    def __init__(self, answer):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._serve, args=(answer,), daemon=True).start()

    def _serve(self, answer):
        while True:
            link, _ = self._server.accept()
            if answer is None:
                link.close()
                continue
            link.recv(99)
            link.sendall(answer)
            time.sleep(0.5)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"", "got nothing in 0.1 s.*is it a GCS controller"),
        (None, "closed the connection|lost"),
        (b"HTTP/1.0 400 Bad Request\r\n", "port is 50000"),
        (b"\x00\x01\n", "printable ASCII"),
        (b"x" * 70000, "without a line"),
        (b"x", "got b'x' in"),
        (b"a,b \n" * 500000, "more than|too long|printable|GCS controller"),
    ],
)
def test_who_is_no_controller_is_found_out(answer, why):
    ear = Ear(answer)
    with pytest.raises(LinkError, match=why) as caught:
        PiRig.connect("127.0.0.1", ear.port, timeout=0.1)
    assert f"127.0.0.1:{ear.port}" in str(caught.value)


def test_nobody_there_is_said_clearly():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(LinkError, match=rf"127\.0\.0\.1:{port}: cannot be reached .*; is the controller on"):
        PiRig.connect("127.0.0.1", port)
    with pytest.raises(LinkError, match=r"host 'no\.such\.host\.invalid'"):
        PiRig.connect("no.such.host.invalid", 1, timeout=1.0)
    with pytest.raises(LinkError, match="1 to 65535"):
        TcpLink("127.0.0.1", 99999)
