"""Serves a page to browsers of this machine: on the loopback interface only, protected by a random token.

A page asks by POST, and is answered by one line of JSON for each event, until all is said or the page breaks the answer
off. An open page keeps one answer open; the server ends soon after the last of them.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.files.bounded_text import parse_json

# The page has its own content security policy.
_HEADERS = {
    "Content-Security-Policy": "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_LONGEST_REQUEST = 1 << 16  # bytes
_HEARTBEAT = 0.25  # seconds between checks of whether the page is still connected


class MalformedError(Exception):
    """A request that is not from a page."""


class GoneError(Exception):
    """The page no longer waits for the answer, or the program ends."""


class PageServer(ThreadingHTTPServer):
    """A server on a free port of the loopback interface.

    `files` are types and contents by name; "" is the page. `answer` is called with the name of a request, its JSON
    object and the `PageRequest` that sends events; it raises MalformedError, or BeltramiError if it cannot be done.
    `reload_timeout`: seconds in which a page may be loaded again. `body_timeout`: seconds in which the body of a
    request comes, which a page on this machine sends at once.
    """

    daemon_threads = True
    # Backlog of connections; Linux limits it to net.core.somaxconn.
    request_queue_size = 1024

    def __init__(
        self, files: Mapping[str, tuple[str, bytes]], answer: Callable[..., None], *,
        reload_timeout: float = 2.0, body_timeout: float = 5.0,
    ) -> None:  # fmt: skip
        super().__init__(("127.0.0.1", 0), PageRequest)
        self.files, self.answer = files, answer
        self._reload_timeout, self.body_timeout = reload_timeout, body_timeout
        self.host = f"127.0.0.1:{self.server_address[1]}"
        self.token, self._ticket = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        self._lock = threading.Lock()
        self.unfinished: set[PageRequest] = set()  # requests whose answers are not yet complete
        self.closing = threading.Event()  # set when all connections are to end

    @property
    def address(self) -> str:
        return f"http://{self.host}/{self.token}/"

    @property
    def first_address(self) -> str:
        """A URL that works once: other users can see the arguments with which a browser is started."""
        return f"http://{self.host}/{self._ticket}"

    def takes_ticket(self, given: str) -> bool:
        """Whether a ticket is valid; it can be used only once."""
        with self._lock:
            is_valid = hmac.compare_digest(given.encode(), self._ticket.encode())
            if is_valid:
                self._ticket = secrets.token_urlsafe(32)
            return is_valid

    def run(self) -> None:
        threading.Thread(target=self.serve_forever, args=(_HEARTBEAT,), daemon=True).start()
        try:
            end = math.inf
            while time.monotonic() < end:
                time.sleep(_HEARTBEAT)
                if not all(request.is_gone() for request in [*self.unfinished]):
                    end = time.monotonic() + self._reload_timeout
        finally:
            self.closing.set()
            self.shutdown()
            self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of closed connections."""


class PageRequest(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 60

    def log_message(self, *_: Any) -> None:
        """Log nothing."""

    def version_string(self) -> str:
        return "beltrami"

    def do_GET(self) -> None:
        name = self._name()
        if name is None or name not in self.server.files:
            self._send(HTTPStatus.NOT_FOUND, "text/plain")
        else:
            self._send(HTTPStatus.OK, *self.server.files[name])

    def do_POST(self) -> None:
        name = self._name()
        if name is None or not self.headers.get("Origin"):
            self._send(HTTPStatus.NOT_FOUND, "text/plain")
            return
        try:
            self.server.answer(name, self._request(), self)
        except GoneError:
            pass
        except MalformedError:
            self._refuse(HTTPStatus.BAD_REQUEST, "the request is malformed")
        except BeltramiError as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
        except Exception as error:
            message = f"unexpected error: {type(error).__name__}: {error}"
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, message)
        finally:
            self.server.unfinished.discard(self)

    def send(self, **event: Any) -> None:
        """Send an event; GoneError if the page has closed the connection."""
        self.require_page()
        if self not in self.server.unfinished:
            self.server.unfinished.add(self)
            self._send(HTTPStatus.OK, "application/json")
        try:
            self.wfile.write(json.dumps(event).encode() + b"\n")
        except OSError as error:
            raise GoneError from error

    def require_page(self) -> None:
        """Raise GoneError if the page has closed the connection, or the program ends."""
        self.require_running()
        if self.is_gone():
            raise GoneError

    def is_gone(self) -> bool:
        try:
            ready, _, _ = select.select([self.connection], [], [], 0)
            return bool(ready) and not self.connection.recv(1, socket.MSG_PEEK)
        except (OSError, ValueError):  # the connection was reset or closed
            return True

    def require_running(self) -> None:
        """Raise GoneError if the program ends."""
        if self.server.closing.is_set():
            raise GoneError

    def wait(self, seconds: float = math.inf) -> None:
        """Wait until the page closes the connection, or some time has passed."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.require_page()
            self.server.closing.wait(min(left, _HEARTBEAT))

    def _refuse(self, status: HTTPStatus, message: str) -> None:
        if self not in self.server.unfinished:
            self._send(status, "application/json", json.dumps({"message": message}).encode())

    def _request(self) -> dict[str, Any]:
        """Return the body of a request; MalformedError if it is truncated or not a JSON object."""
        try:
            length = int(self.headers.get("Content-Length", ""))
            if not 0 < length <= _LONGEST_REQUEST:
                raise MalformedError
            self.connection.settimeout(self.server.body_timeout)
            body = self.rfile.read(length)
            self.connection.settimeout(self.timeout)
            request = parse_json(body)
        except (ValueError, TimeoutError) as error:
            raise MalformedError from error
        if len(body) < length or not isinstance(request, dict):
            raise MalformedError
        return request

    def _name(self) -> str | None:
        """Return the requested name; None if the request is not from a page of this server."""
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        if self.headers.get("Host") != self.server.host or origin not in (None, f"http://{self.server.host}"):
            return None
        token, slash, name = self.path.removeprefix("/").partition("/")
        if not slash and self.server.takes_ticket(token):
            self._send(HTTPStatus.SEE_OTHER, "text/plain", Location=f"/{self.server.token}/")
            raise ConnectionAbortedError
        if not slash or not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return None
        return name if not name or site in ("same-origin", "none") else None

    def _send(self, status: HTTPStatus, kind: str, body: bytes = b"", **more: str) -> None:
        """Send headers and the body, or its beginning; the body ends when the connection is closed."""
        self.send_response(status)
        for header, value in {**_HEADERS, "Content-Type": kind, **more}.items():
            self.send_header(header, value)
        self.end_headers()
        self.wfile.write(body)
