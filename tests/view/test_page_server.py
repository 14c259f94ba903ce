"""The server of `beltrami view`: who may ask, and requests that no page sends, which change nothing."""

import contextlib
import http.client
import json
import socket
import threading
import time

import pytest

from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.live.live import Live
from beltrami_cli.view.live.server import PageServer
from cli.commands import SAMPLES

# One value of each type that JSON has, and some that only look right.
VALUES = (None, True, 1, -1, 0.5, float("inf"), float("nan"), 10**30, "", "x", [], [1], [[1]], {}, {"a": 1})
FOCUS = [0, 0, 0, 0, 0, 1.5]


@pytest.fixture(scope="module")
def live():
    return Live(str(SAMPLES / "nonmanifold-noisy.ply"), SmoothSettings(), Job(), lambda *_: "command")


@pytest.fixture
def page_server(live):
    made = PageServer(live.files, live.answer)
    thread = threading.Thread(target=made.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield made
    made.shutdown()
    made.server_close()
    thread.join()


def own(server):
    """Return the headers that a page of the server sends."""
    return {"Host": server.host, "Origin": f"http://{server.host}"}


def answered(page_server, method, path, body=None, **headers):
    """Send a request, by default as from its own page; return the answer, which is read."""
    connection = http.client.HTTPConnection(page_server.host, timeout=10)
    with contextlib.closing(connection):
        sent = {name: value for name, value in {**own(page_server), **headers}.items() if value is not None}
        connection.request(method, path, body, sent)
        answer = connection.getresponse()
        return answer, answer.read()


def sent(page_server, name, body, **headers):
    """Send a request from its own page; return the status and the message of the answer."""
    answer, content = answered(page_server, "POST", f"/{page_server.token}/{name}", body, **headers)
    return answer.status, json.loads(content).get("message")


def test_only_those_with_the_token_and_from_its_own_origin_get_anything(page_server):
    token, body = page_server.token, '{"values": {}}'
    (name,) = (name for name in page_server.files if name)
    assert answered(page_server, "GET", f"/{token}/{name}")[0].status == 200
    assert answered(page_server, "GET", f"/{token}/", Origin=None)[0].status == 200
    for method, path, headers in (
        ("GET", "/", {}), ("GET", f"/{name}", {}), ("GET", f"/{token}", {}),
        ("GET", f"/{token[:-1]}x/{name}", {}), ("GET", f"/{token}/../../etc/passwd", {}),
        ("GET", f"/{token}/{name}", {"Host": "evil.example"}),
        ("GET", f"/{token}/{name}", {"Origin": "http://evil.example"}),
        ("GET", f"/{token}/{name}", {"Sec-Fetch-Site": "cross-site"}),
        ("POST", f"/{token}/save", {"Origin": None}), ("POST", f"/{token}/save", {"Origin": "null"}),
    ):  # fmt: skip
        answer, content = answered(page_server, method, path, body if method == "POST" else None, **headers)
        assert (answer.status, content) == (404, b""), (method, path, headers)
    assert answered(page_server, "POST", f"/{token}/other", body)[0].status == 400


def test_clients_wait_for_a_server_that_is_busy():
    """A queue that is full drops connections, which clients try again after seconds."""
    waiting = PageServer({}, lambda *request: None)
    with contextlib.ExitStack() as clients:
        clients.callback(waiting.server_close)
        for _ in range(200):
            clients.enter_context(socket.create_connection(waiting.server_address, timeout=0.5))


def test_the_address_that_a_browser_is_started_with_is_good_once(page_server):
    path = page_server.first_address.removeprefix(f"http://{page_server.host}")
    for expected in (303, 404):
        answer, _ = answered(page_server, "GET", path, Origin=None)
        assert answer.status == expected
        assert (answer.getheader("Location") == f"/{page_server.token}/") == (expected == 303)


def test_the_program_ends_with_its_last_page_though_work_goes_on():
    is_worked = threading.Event()

    def work(name, asked, request):
        request.send(kind="accepted")
        is_worked.wait(60)

    server = PageServer({}, work, reload_timeout=0.1)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    connection = http.client.HTTPConnection(server.host, timeout=10)
    connection.request("POST", f"/{server.token}/change", "{}", own(server))
    with contextlib.closing(connection), connection.getresponse() as answer:
        assert answer.readline() == b'{"kind": "accepted"}\n'
        thread.join(timeout=1)
        assert thread.is_alive()
    thread.join(timeout=30)
    assert not thread.is_alive()
    is_worked.set()


MALFORMED = (400, "the request is malformed")


BODIES = [
    b"", b"[]", b"1", b"null", b"{", b"\xff", b'{"values": 1}', b"[" * 60_000, b'{"a":' * 10_000, b"{}" * 40_000,
]  # fmt: skip


def test_bodies_that_are_no_request_or_not_as_long_as_they_say(page_server):
    page_server.body_timeout = 0.1
    for name in ("change", "save"):
        for body in BODIES:
            assert sent(page_server, name, body) == MALFORMED, body[:12]
        for length in ("", "-1", "1.5", "x", "9" * 5000, "3"):
            assert sent(page_server, name, None, **{"Content-Length": length}) == MALFORMED, length


def test_a_body_that_ends_too_early(page_server):
    host, port = page_server.host.split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        origin = f"Host: {page_server.host}\r\nOrigin: http://{page_server.host}"
        head = f"POST /{page_server.token}/change HTTP/1.1\r\n{origin}\r\nContent-Length: 20\r\n\r\n{{}}"
        connection.sendall(head.encode())
        connection.shutdown(socket.SHUT_WR)
        assert connection.recv(12) == b"HTTP/1.0 400"


CHANGE = {"values": {}, "target": "out.ply", "layer": 0, "focus": FOCUS}
SAVE = {"values": {}, "target": "out.ply", "overwrite": False}
WRONG = {
    "layer": [-1, 1],
    "focus": [[], [1], [[1]], [0, 0, float("nan")], [0, 0, "x"], [*FOCUS[:5], True], [*FOCUS, 1]],
}


@pytest.mark.parametrize(
    ("request_name", "name"), [*(("change", name) for name in CHANGE), *(("save", name) for name in SAVE)]
)
def test_parts_of_another_type_save_and_change_nothing(request_name, name, page_server, live, monkeypatch):
    saved, right = [], {"change": CHANGE, "save": SAVE}[request_name]
    monkeypatch.setattr(live, "_save", lambda *_, **__: saved.append(1))
    for value in (*WRONG.get(name, ()), *(each for each in VALUES if type(each) is not type(right[name]))):
        body = json.dumps({**right, name: value})
        assert sent(page_server, request_name, body) == MALFORMED, value
    if request_name == "save":
        lacking = {key: value for key, value in right.items() if key != name}
        assert sent(page_server, "save", json.dumps(lacking)) == MALFORMED
    assert not page_server.unfinished
    assert saved == []


@pytest.mark.slow
def test_a_change_that_is_broken_off_ends_and_leaves_nothing(page_server):
    connection = http.client.HTTPConnection(page_server.host, timeout=10)
    connection.request("POST", f"/{page_server.token}/change", json.dumps(CHANGE), own(page_server))
    assert json.loads(connection.getresponse().readline()) == {"kind": "accepted", "command": "command"}
    assert page_server.unfinished
    connection.close()
    end = time.monotonic() + 60
    while page_server.unfinished:
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("control", ["iterations", "t", "beta", "noise", "strength", "patches", "slots"])
def test_values_of_another_type_are_refused_in_a_sentence(control, page_server):
    for value in (True, [[1]], {"a": 1}, "x", -1, float("nan")):
        status, said = sent(page_server, "save", json.dumps({"values": {control: value}, "target": "-"}))
        assert status == 409, value
        assert control in said or "noise" in said


def test_an_unexpected_error_is_answered(page_server, live, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr(live, "_save", fail)
    said = "unexpected error: ZeroDivisionError: of ours"
    assert sent(page_server, "save", json.dumps(SAVE)) == (500, said)
