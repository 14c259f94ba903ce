"""`beltrami view`: a page that smooths, for those who may see it only, and what it saves.

Its server: who may ask, and requests that no page sends, which change nothing.
"""

import contextlib
import http.client
import json
import re
import shlex
import shutil
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import pytest

from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.live import Live
from beltrami_cli.view.server import PageServer
from cli.commands import COMMAND, SAMPLES, beltrami
from cli.pictures import textured_square
from view.browsing import Served, Viewer

NOISY = SAMPLES / "nonmanifold-noisy.ply"


@pytest.fixture
def served(tmp_path):
    running = []

    def start(source, *arguments):
        running.append(Served(source, tmp_path, *arguments))
        return running[-1]

    yield start
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait()
        each.process.stderr.close()


class LiveViewer(Viewer):
    """The page in a browser."""

    def data(self, name):
        return self.page.locator("#viewer").get_attribute(f"data-{name}")

    def wait_for(self, name, before=None):
        """Wait until something of the page is there, or another than before."""
        end = time.monotonic() + 60
        while self.data(name) in (None, before):
            assert time.monotonic() < end, self.page.locator("#state").inner_text()
            self.page.wait_for_timeout(20)
        return self.data(name)

    def slide(self, name, value):
        self.page.locator(f"#{name}").fill(str(value))

    def roughness(self):
        """How much neighbouring pixels in the middle of the view differ."""
        shot = read_image(self.part("place").screenshot(), "").pixels.astype(float)
        height, width = shot.shape[:2]
        middle = shot[height // 2 - 40 : height // 2 + 40, width // 2 - 40 : width // 2 + 40, :3]
        return float(np.abs(np.diff(middle, axis=1)).mean())


# Threads of the core that do not end in time would make Python abort as it ends.
NEVER_ENDS = (
    "from beltrami_cli.view.live import Live; Live.close = lambda self: False; "
    "from beltrami_cli.__main__ import main; main()"
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGUSR1"])
def test_a_signal_ends_it_in_one_line_with_its_code_while_work_goes_on(name):
    number = getattr(signal, name)
    command = [*COMMAND[:2], "-c", NEVER_ENDS, "view", NOISY, "--no-open"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert "shown at" in process.stderr.readline()
        process.send_signal(number)
        said = process.stderr.read().splitlines()
    assert said[-1] == "beltrami: interrupted; files are as they were, or complete"
    assert process.returncode == 128 + number


@pytest.mark.slow
def test_a_change_arrives_and_closing_the_page_ends_the_program(browser, served):
    live = served(NOISY, "--strength", "gentle")
    viewer = LiveViewer(browser, live.address)
    assert viewer.page.locator("#strength").input_value() == "0.7"
    assert "--strength gentle" in viewer.page.locator("#command").inner_text()
    viewer.slide("strength", 1)
    viewer.page.get_by_label("after", exact=True).check()
    first = viewer.wait_for("whole")
    smooth_one = viewer.roughness()
    viewer.slide("iterations", 1)
    viewer.slide("beta", 40)
    viewer.wait_for("whole", first)
    rough = viewer.roughness()
    assert smooth_one < 0.8 * rough
    viewer.page.keyboard.press("b")
    assert viewer.roughness() > rough
    command = viewer.page.locator("#command").inner_text()
    assert all(words in command for words in ("-n 1", "--beta 40", "--fast"))
    assert viewer.errors == []
    viewer.page.close()
    assert live.process.wait(timeout=15) == 0


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".obj", ".png"])
def test_previews_of_textures_and_images_come_before_the_whole(browser, served, tmp_path, suffix):
    noise = np.random.default_rng(1).integers(60, 200, (12, 12, 3))
    source = textured_square(tmp_path / "square.obj", noise).with_suffix(suffix)
    viewer = LiveViewer(browser, served(source.name).address)
    viewer.page.get_by_label("after", exact=True).check()
    viewer.wait_for("whole")
    rough = viewer.roughness()
    before = viewer.data("previews")
    for name, value in (("iterations", 8), ("time step", 10), ("beta", 0)):
        viewer.page.get_by_label(name, exact=True).fill(str(value))
    viewer.wait_for("previews", before)
    viewer.wait_for("whole", viewer.data("whole"))
    assert viewer.roughness() < rough
    assert viewer.errors == []


@pytest.mark.slow
def test_what_is_saved_is_what_smooth_writes_with_its_refusals(browser, served, tmp_path):
    for name in ("mirrored-noisy.obj", "mirrored-noisy.mtl", "mirrored-noisy.png"):
        shutil.copy(SAMPLES / name, tmp_path)
    live = served("mirrored-noisy.obj")
    viewer = LiveViewer(browser, live.address)
    viewer.slide("iterations", 2)
    viewer.slide("beta", 9)
    target, save = viewer.page.locator("#target"), viewer.page.get_by_role("button", name="Save", exact=True)
    target.fill("saved.obj")
    target.press("Tab")
    save.click()
    viewer.page.wait_for_selector("#saved:has-text('Written')", timeout=60_000)
    words = shlex.split(viewer.page.locator("#command").inner_text())
    assert words[:4] == ["beltrami", "smooth", "mirrored-noisy.obj", "saved.obj"]
    other = tmp_path / "other"
    other.mkdir()
    for name in ("mirrored-noisy.obj", "mirrored-noisy.mtl", "mirrored-noisy.png"):
        shutil.copy(SAMPLES / name, other)
    beltrami(*words[1:], cwd=other)
    written = sorted(path.name for path in other.iterdir())
    assert written == sorted(path.name for path in tmp_path.iterdir() if path.is_file())
    assert all((other / name).read_bytes() == (tmp_path / name).read_bytes() for name in written)
    save.click()
    refused = beltrami(*words[1:], code=4, cwd=other).stderr.decode().strip().removeprefix("beltrami: ")
    viewer.page.locator("#saved", has_text=refused).wait_for(timeout=30_000)


@pytest.mark.slow
def test_noise_is_given_or_shown_as_estimated_and_refused_in_the_words_of_the_program(
    browser, served, tmp_path
):
    viewer = LiveViewer(browser, served(NOISY).address)
    first, noise = viewer.wait_for("whole"), viewer.page.get_by_label("noise", exact=True)
    estimated = re.fullmatch(r"estimated: (?:about )?([\d.]+/255).*", noise.get_attribute("placeholder"))[1]
    assert re.search(r"noise\s+.*[\d.]+/255", viewer.page.locator("#used").inner_text())
    command = viewer.page.locator("#command").inner_text()
    assert "--noise" not in command
    noise.fill("a lot")
    noise.press("Enter")
    refused = (
        beltrami("smooth", NOISY, tmp_path / "out.ply", "--noise", "a lot", code=2).stderr.decode().strip()
    )
    said = refused.rpartition("must be")[2]
    viewer.page.locator("#state", has_text=said).wait_for(timeout=30_000)
    assert viewer.page.locator("#command").inner_text() == command
    noise.fill(estimated)
    noise.press("Enter")
    viewer.wait_for("whole", first)
    assert f"--noise {estimated} " in viewer.page.locator("#command").inner_text() + " "
    assert f"given as {estimated}" in viewer.page.locator("#used").inner_text()


@pytest.mark.slow
def test_two_pages_are_apart_and_learn_that_the_program_was_killed(browser, served):
    live = served(NOISY)
    one, other = LiveViewer(browser, live.address), LiveViewer(browser, live.address)
    one.wait_for("whole")
    shown = other.wait_for("whole")
    one.slide("beta", 3)
    one.wait_for("whole", one.data("whole"))
    assert "--beta 3" in one.page.locator("#command").inner_text()
    assert "--beta" not in other.page.locator("#command").inner_text()
    assert other.data("whole") == shown
    one.page.close()
    other.slide("beta", 5)
    other.wait_for("whole", shown)
    live.process.kill()
    other.page.locator("#state", has_text="has ended").wait_for(timeout=15_000)
    assert other.page.locator("#beta").is_disabled()


@pytest.mark.slow
def test_a_page_says_why_there_is_no_preview(browser, served):
    viewer = LiveViewer(browser, served(SAMPLES / "torus-two-noisy.gltf", "--level", "-n", "1").address)
    viewer.page.locator("#state", has_text="No preview: exposure steps are levelled").wait_for(timeout=30_000)
    viewer.wait_for("whole")
    assert viewer.page.locator("#state").inner_text() == "Done."
    assert viewer.data("previews") is None
    assert viewer.errors == []


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

    server = PageServer({}, work, grace=0.1)
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
    page_server.patience = 0.1
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
    assert not page_server.answered
    assert saved == []


@pytest.mark.slow
def test_a_change_that_is_broken_off_ends_and_leaves_nothing(page_server):
    connection = http.client.HTTPConnection(page_server.host, timeout=10)
    connection.request("POST", f"/{page_server.token}/change", json.dumps(CHANGE), own(page_server))
    assert json.loads(connection.getresponse().readline()) == {"kind": "accepted", "command": "command"}
    assert page_server.answered
    connection.close()
    end = time.monotonic() + 60
    while page_server.answered:
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
