"""The emergency stop: who may press it, and that nobody else can or can be in the way."""

import socket
import threading
import time

import numpy as np
import pytest
from observed_rig import ORIGIN, asked

from dehyst.workbench.rig.stop_listener import StopListener

KEY = "a key of the workbench"


@pytest.fixture
def stop():
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    pressed = []
    listener = StopListener(listening, KEY, [ORIGIN], lambda confirm: (pressed.append(confirm), confirm(True)))
    listener.start()
    listener.pressed = pressed
    yield listener
    assert asked(listener.port, "POST /stop HTTP/1.1", headers(listener))[0] == 200


def headers(stop, **change):
    plain = {"Host": f"127.0.0.1:{stop.port}", "Origin": ORIGIN, "X-Dehyst-Stop": KEY}
    return {name: value for name, value in {**plain, **change}.items() if value is not None}


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST"])
def test_the_page_may_stop(stop, host):
    status, answer = asked(stop.port, "POST /stop HTTP/1.1", headers(stop, Host=f"{host}:{stop.port}"))
    assert status == 200
    assert len(stop.pressed) == 1
    assert f"Access-Control-Allow-Origin: {ORIGIN}\r\n" in answer


@pytest.mark.parametrize(
    "change",
    [
        {"Host": None},
        {"Host": "127.0.0.1"},
        {"Host": "evil.example:80"},
        {"Host": "127.0.0.1:1"},
        {"Origin": None},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": ORIGIN + ".evil.example"},
        {"Origin": ORIGIN.upper()},
        {"X-Dehyst-Stop": None},
        {"X-Dehyst-Stop": ""},
        {"X-Dehyst-Stop": KEY[:-1]},
        {"X-Dehyst-Stop": KEY + "x"},
        {"X-Dehyst-Stop": "schlüssel"},
    ],
)
def test_nobody_else_may(stop, change):
    status, answer = asked(stop.port, "POST /stop HTTP/1.1", headers(stop, **change))
    assert status == 403
    assert stop.pressed == []
    known = change.get("Origin", ORIGIN) == ORIGIN
    assert ("Access-Control-Allow-Origin" in answer) == known
    assert KEY not in answer


@pytest.mark.parametrize(
    ("first", "status"),
    [
        ("GET /stop HTTP/1.1", 405),
        ("POST / HTTP/1.1", 404),
        ("POST /stop?x HTTP/1.1", 404),
        ("POST /../stop HTTP/1.1", 404),
        ("POST /stop", 400),
        ("POST /stop HTTP/2.0", 400),
        ("nonsense", 400),
    ],
)
def test_only_that_request_stops(stop, first, status):
    assert asked(stop.port, first, headers(stop))[0] == status
    assert stop.pressed == []


def test_a_header_that_comes_twice_is_refused(stop):
    assert asked(stop.port, "POST /stop HTTP/1.1\r\nHost: evil.example", headers(stop))[0] == 400
    assert asked(stop.port, "POST /stop HTTP/1.1\r\n folded", headers(stop))[0] == 400
    assert stop.pressed == []


def test_the_preflight_is_answered_for_the_page_only(stop):
    asks = {"X-Dehyst-Stop": None, "Access-Control-Request-Method": "POST"}
    status, answer = asked(stop.port, "OPTIONS /stop HTTP/1.1", headers(stop, **asks))
    assert status == 204
    assert f"Access-Control-Allow-Origin: {ORIGIN}\r\n" in answer
    assert "Access-Control-Allow-Headers: x-dehyst-stop\r\n" in answer
    assert "Access-Control-Allow-Methods: POST\r\n" in answer
    asks["Origin"] = "http://evil.example"
    status, answer = asked(stop.port, "OPTIONS /stop HTTP/1.1", headers(stop, **asks))
    assert status == 403
    assert "Access-Control" not in answer
    assert stop.pressed == []


def test_a_request_that_is_too_long_is_refused(stop):
    assert asked(stop.port, "POST /stop HTTP/1.1", headers(stop, X=8200 * "x"))[0] in (413, 0)
    assert stop.pressed == []


def test_a_request_in_small_pieces_is_understood(stop):
    text = "POST /stop HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in headers(stop).items())
    with socket.create_connection(("127.0.0.1", stop.port)) as link:
        for byte in (text + "\r\n").encode():
            link.sendall(bytes([byte]))
        assert link.recv(1000).startswith(b"HTTP/1.1 200 OK")


def test_connections_that_hang_are_not_in_the_way(stop):
    links = [socket.create_connection(("127.0.0.1", stop.port)) for _ in range(200)]
    for link in links:
        link.sendall(b"POST /stop HTTP/1.1\r\n")
    began = time.monotonic()
    assert asked(stop.port, "POST /stop HTTP/1.1", headers(stop))[0] == 200
    assert time.monotonic() - began < 5.0
    for link in links:
        link.close()


def test_a_connection_that_hangs_is_closed(stop):
    with socket.create_connection(("127.0.0.1", stop.port), 5.0) as link:
        link.sendall(b"POST")
        assert link.recv(10) == b""


def test_a_thousand_random_requests_stop_nothing(stop):
    random = np.random.default_rng(17)
    text = ("POST /stop HTTP/1.1\r\n" + "".join(f"{n}: {v}\r\n" for n, v in headers(stop).items()) + "\r\n").encode()
    # Harmless without the last letter of the key.
    text = text.replace(KEY.encode(), KEY[:-1].encode())
    for _ in range(1000):
        data = np.frombuffer(text, dtype=np.uint8).copy()
        hit = random.random(data.size) < random.choice([0.01, 0.1, 1.0])
        data[hit] = random.integers(0, 256, int(hit.sum()), dtype=np.uint8)
        with socket.create_connection(("127.0.0.1", stop.port), 5.0) as link:
            link.sendall(data[: random.integers(1, data.size + 1)].tobytes())
    assert stop.pressed == []


@pytest.mark.parametrize(("armed", "status"), [(True, 200), (False, 409)])
def test_a_stop_is_answered_when_it_is_confirmed(armed, status):
    listening, pressed, answered = socket.socket(), [], []
    listening.bind(("127.0.0.1", 0))
    listener = StopListener(listening, KEY, [ORIGIN], pressed.append)
    listener.start()
    press = threading.Thread(
        target=lambda: answered.append(asked(listener.port, "POST /stop HTTP/1.1", headers(listener)))
    )
    press.start()
    press.join(0.3)
    assert len(pressed) == 1
    assert answered == []
    pressed[0](armed)
    press.join()
    assert answered[0][0] == status
    assert (b'"stopped": true' in answered[0][1].encode()) == armed


def test_a_stop_that_nobody_confirms_is_answered_so():
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    listener = StopListener(listening, KEY, [ORIGIN], lambda confirm: None)
    listener.start()
    began = time.monotonic()
    assert asked(listener.port, "POST /stop HTTP/1.1", headers(listener))[0] == 504
    assert 1.9 < time.monotonic() - began < 4.0


def test_without_a_key_nobody_may_stop():
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    pressed = []
    listener = StopListener(listening, "", [ORIGIN], pressed.append)
    listener.start()
    assert asked(listener.port, "POST /stop HTTP/1.1", headers(listener, **{"X-Dehyst-Stop": ""}))[0] == 403
    assert pressed == []
