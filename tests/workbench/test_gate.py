"""Nothing passes the gate but the page itself: no foreign host, page, token or path, and no random request."""

import http.client
import json
import random
import re
import string

import httpx
import pytest
from websockets.exceptions import InvalidHandshake, InvalidStatus
from websockets.sync.client import connect
from workbench_client import served, until

from dehyst.records import read
from dehyst.workbench.folder import Folder
from dehyst.workbench.server import EXAMPLE

ROUTES = [
    ("GET", "/"),
    ("GET", "/api/state"),
    ("PUT", "/api/records?name=x.csv"),
    ("POST", "/api/models"),
    ("GET", "/files/commands.sh"),
    ("GET", "/page/index.html"),
    ("DELETE", "/api/records/r1"),
]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with served(tmp_path_factory.mktemp("gate") / "bench") as running:
        yield running


@pytest.fixture(scope="module")
def client(bench):
    with bench.client() as opened:
        yield opened


def cookie(client):
    return "; ".join(f"{name}={value}" for name, value in client.cookies.items())


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_without_the_cookie_every_request_is_refused(bench, method, path):
    answer = httpx.request(method, bench.base + path, headers={"Origin": bench.base})
    assert answer.status_code == 403 and "workbench printed" in answer.text


FOREIGN = [
    {"Host": "evil.example"},
    {"Host": "127.0.0.1"},
    {"Host": "127.0.0.1.evil.example:8754"},
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://127.0.0.1:1"},
    {"Origin": "https://127.0.0.1"},
]
# Headers that a browser sends for another site, and a change without an origin.
SENT = [
    *((method, path, headers) for method, path in ROUTES for headers in FOREIGN),
    *((*route, {"Sec-Fetch-Site": f"{k}-site"}) for route in (ROUTES[1], ROUTES[4]) for k in ("cross", "same")),
    ("POST", "/api/models", {"Origin": None}),
]


@pytest.mark.parametrize(("method", "path", "headers"), SENT, ids=str)
def test_a_foreign_host_or_page_is_refused_even_with_the_cookie(bench, client, method, path, headers):
    given = {"Origin": bench.base, "Cookie": cookie(client), **headers}
    sent = {name: value for name, value in given.items() if value is not None}
    assert httpx.request(method, bench.base + path, headers=sent).status_code == 403
    assert httpx.get(f"{bench.base}/api/state", headers={"Cookie": cookie(client)}).status_code == 200


@pytest.mark.parametrize("token", ["", "x", "A" * 43, "%00", "é"])
def test_a_wrong_token_gives_no_cookie(bench, token):
    answer = httpx.get(f"{bench.base}/", params={"token": token})
    assert answer.status_code == 403 and not answer.cookies


def test_the_cookie_is_hidden_from_scripts_and_from_other_sites(bench):
    answer = httpx.get(bench.link)
    words = answer.headers["set-cookie"]
    assert words.startswith(f"dehyst-{bench.port}=")
    assert "HttpOnly" in words and "SameSite=Strict" in words
    assert bench.link.partition("token=")[2] not in words
    # Without this icon a browser asks for /favicon.ico, which does not exist.
    assert 'rel="icon" href="data:,"' in answer.text


def test_the_token_admits_only_to_the_page(bench):
    token = bench.link.partition("token=")[2]
    for method, path in ROUTES[1:]:
        joined = f"{path}{'&' if '?' in path else '?'}token={token}"
        assert httpx.request(method, bench.base + joined, headers={"Origin": bench.base}).status_code == 403


def test_the_link_and_the_private_file_admit_a_browser(bench):
    assert [httpx.get(bench.link).status_code for _ in range(2)] == [200, 200]
    page = bench.folder / "open-workbench.html"
    assert page.stat().st_mode & 0o777 == 0o600
    assert bench.link in page.read_text()


@pytest.mark.parametrize("mode", [None, 0o755])
def test_nobody_else_may_read_the_folder(tmp_path, mode):
    folder = tmp_path / "bench"
    if mode is not None:
        folder.mkdir(mode)
        folder.chmod(mode)
    for _ in range(2):
        made = Folder(folder)
        made.close()
        assert (folder.stat().st_mode & 0o777, made.privacy) == (0o700, "")


def test_a_repeated_header_is_refused(bench, client):
    for name, value in (("Origin", "http://evil.example"), ("Host", "evil.example")):
        connection = http.client.HTTPConnection("127.0.0.1", bench.port)
        connection.putrequest("GET", "/api/state", skip_host=True)
        for header, words in (("Host", f"127.0.0.1:{bench.port}"), ("Cookie", cookie(client)), (name, value)):
            connection.putheader(header, words)
        connection.endheaders()
        assert connection.getresponse().status in (400, 403)
        connection.close()


@pytest.mark.parametrize(
    "headers", [{}, {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Cookie": "dehyst=1"}], ids=str
)
def test_a_socket_of_another_page_is_refused(bench, client, headers):
    given = dict(headers)
    if "Origin" in headers:
        given["Cookie"] = cookie(client)
    origin = given.pop("Origin", None)
    with (
        pytest.raises((InvalidStatus, InvalidHandshake)),
        connect(f"ws://127.0.0.1:{bench.port}/api/events", origin=origin, additional_headers=given),
    ):
        pass


def test_the_socket_of_the_page_gets_the_state(bench, client):
    url = f"ws://127.0.0.1:{bench.port}/api/events"
    with connect(url, origin=bench.base, additional_headers={"Cookie": cookie(client)}) as news:
        assert json.loads(news.recv(timeout=10)).keys() >= {"records", "models", "jobs"}
        for junk in ("", "{", "[]", "x" * 60_000, b"\x00"):
            news.send(junk)
        assert client.get("/api/state").status_code == 200


def test_the_policy_allows_only_files_of_the_workbench(client):
    headers = client.get("/").headers
    policy = headers["content-security-policy"]
    assert policy.startswith("default-src 'self'") and "frame-ancestors 'none'" in policy
    assert "unsafe-inline" not in policy
    assert headers["x-content-type-options"] == "nosniff"


OUTSIDE = r"""../../etc/passwd ..%2f..%2fetc%2fpasswd %2e%2e/%2e%2e/etc/passwd records/../../secret.txt /etc/passwd
//etc/passwd workbench.json .lock records/.hidden records\..\secret.txt records%00.csv . records/link"""


@pytest.mark.parametrize("path", ["", *OUTSIDE.split()])
def test_no_requested_path_leads_out_of_the_folder(bench, path):
    (bench.folder.parent / "secret.txt").write_text("secret")
    (bench.folder / "records" / ".hidden").write_text("secret")
    link = bench.folder / "records" / "link"
    if not link.is_symlink():
        link.symlink_to(bench.folder.parent / "secret.txt")
    with bench.client() as fresh:
        connection = http.client.HTTPConnection("127.0.0.1", bench.port)
        connection.request("GET", f"/files/{path}", headers={"Cookie": cookie(fresh)})
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
    assert answer.status in (303, 307, 400, 403, 404)
    assert b"secret" not in body.replace(b"secret.txt", b"")
    assert b"root:" not in body


@pytest.mark.parametrize(
    "name",
    ["../../x.csv", "/etc/x.csv", "..\\..\\x.csv", ".hidden", "a" * 5000, "\n", "x.csv/../../y", "con?.csv", "ä.csv"],
)
def test_an_uploads_name_stays_in_the_folder(bench, client, name):
    before = {path.name for path in bench.folder.parent.iterdir()}
    answer = client.put("/api/records", params={"name": name}, content=b"time_s,voltage_V,displacement_um\n0,1,2\n")
    assert answer.status_code == 200, answer.text
    assert {path.name for path in bench.folder.parent.iterdir()} == before
    source = next(own for own in client.get("/api/state").json()["records"] if own["id"] == answer.json()["id"])
    assert (bench.folder / source["source"]).resolve().parent == (bench.folder / "uploads").resolve()


def test_an_empty_or_malformed_upload_is_refused_with_a_sentence(bench, client):
    assert client.put("/api/records", params={"name": "empty.csv"}, content=b"").status_code == 400
    rubbish = (random.Random(k).randbytes(2000) for k in range(4))
    for k, content in enumerate([b"\x00" * 100, b"PK\x03\x04rubbish", *rubbish]):
        for suffix in ("csv", "npz", "h5", "exe"):
            answer = client.put("/api/records", params={"name": f"{k}.{suffix}"}, content=content)
            assert answer.status_code == 200
    state = until(client, lambda state: all(record["status"] != "reading" for record in state["records"]))
    refused = [record for record in state["records"] if record["name"].isdigit()]
    assert [record["status"] for record in refused] == ["refused"] * 24
    assert all(len(record["error"]) > 10 and "Traceback" not in record["error"] for record in refused)


@pytest.mark.parametrize(
    "body", [b"{", b"[]", b"1", b'"x"', b"[" * 100_000, b"\xff\xfe", b'{"train": NaN}', b'{"options": "\\ud800"}']
)
def test_a_body_that_is_no_object_is_refused(bench, client, body):
    for path in ("/api/models", "/api/models/m1/follow", "/api/records/r1/read"):
        answer = client.post(path, content=body)
        assert answer.status_code == 400
        assert "no JSON" in answer.json()["error"]


@pytest.mark.parametrize("requests", [200, pytest.param(1000, marks=pytest.mark.nightly)])
def test_random_requests_do_no_harm(bench, client, requests):
    dice = random.Random(17)
    names = "models records voltages files api page jobs r1 m1 v1 j1 data path end . .. %2e *"
    words = [*names.split(), ""]
    with bench.client() as fresh:
        for _ in range(requests):
            path = "/" + "/".join(dice.choices(words, k=dice.randint(0, 5)))
            junk = "".join(dice.choices(string.printable, k=dice.randint(0, 60))).encode()
            body = dice.choice([junk, b"{}", b'{"train": ["r1"]}', b'{"options": 3}', b'{"points": [["x", {}]]}'])
            method = dice.choice(["GET", "POST", "PUT", "DELETE", "PATCH", "HEAD", "OPTIONS", "TRACE"])
            try:
                answer = fresh.request(method, path, content=body, follow_redirects=False)
            except httpx.InvalidURL:
                continue
            assert answer.status_code < 500, (method, path, body)
    assert (client.get("/api/state").status_code, bench.process.poll()) == (200, None)


def test_the_server_has_exactly_the_scripts_of_the_page(client):
    found, left = set(), {"app.js"}
    while left:
        answer = client.get(f"/page/{left.pop()}")
        assert answer.status_code == 200
        found.add(answer.url.path)
        names = re.findall(r'^import .*"(?:\./|/page/)([a-z_]+\.js)"', answer.text, re.M)
        left |= {name for name in names if f"/page/{name}" not in found}
    assert len(found) > 15
    for path in ("/page/", "/page/x.js", "/page/index.html", "/page/../server.py", "/page/%2e%2e/server.py"):
        assert client.get(path).status_code == 404


def test_the_example_record_can_be_read(client, tmp_path):
    (tmp_path / EXAMPLE).write_bytes(client.get(f"/page/{EXAMPLE}").content)
    assert len(read(tmp_path / EXAMPLE)) > 1000
