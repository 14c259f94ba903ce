"""Serves one page to the browsers of this machine: on loopback only, to those who know a random token."""

from __future__ import annotations

import hmac
import json
import secrets
import select
import socket
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from queue import Empty, Queue
from typing import Any, Protocol

from beltrami_cli.formats.access import parse_json

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self' blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_LONGEST_REQUEST = 1 << 16  # bytes
_BODY_SECONDS = 5.0  # in which the rest of a request comes, which a page on this machine sends at once
_BEAT = 0.25  # seconds between looks at whether a page is still there
_GRACE = 2.0  # seconds in which a page may be loaded again

Events = Queue[dict[str, Any]]


class MalformedError(Exception):
    """A request that no page sends."""


class RefusedError(Exception):
    """A request that cannot be fulfilled, with a sentence for the user."""


class Application(Protocol):
    """The application behind the pages."""

    files: Mapping[str, tuple[str, bytes]]  # types and contents by name; "" is the page

    def events_of(self, page: str) -> Events: ...  # what a page is sent from now on
    def leave(self, page: str) -> None: ...
    def answer(self, name: str, request: dict[str, Any]) -> dict[str, Any]:
        """Do what a page asks for; MalformedError, or RefusedError if it cannot be done."""


class PageServer(ThreadingHTTPServer):
    """A server on a free port of the loopback interface."""

    daemon_threads = True

    def __init__(self, application: Application) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.application = application
        self.host = f"127.0.0.1:{self.server_address[1]}"
        self.token, self._ticket = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        self._pages, self._lock = 0, threading.Lock()
        self.closing = threading.Event()  # when all connections are to end
        self._left: threading.Timer | None = None

    @property
    def address(self) -> str:
        return f"http://{self.host}/{self.token}/"

    @property
    def first_address(self) -> str:
        """An address that leads to the page once: others can see what a browser is started with."""
        return f"http://{self.host}/{self._ticket}"

    def takes_ticket(self, given: str) -> bool:
        """Whether a ticket is the one that is valid, which it is not any more then."""
        with self._lock:
            is_valid = hmac.compare_digest(given.encode(), self._ticket.encode())
            if is_valid:
                self._ticket = secrets.token_urlsafe(32)
            return is_valid

    def run(self) -> None:
        """Serve until the last page is closed."""
        threading.Thread(target=self.serve_forever, args=(_BEAT,), daemon=True).start()
        try:
            while not self.closing.wait(_BEAT):
                pass
        finally:
            self.closing.set()
            self.shutdown()
            self.server_close()

    def page_came(self) -> None:
        with self._lock:
            self._pages += 1
            if self._left is not None:
                self._left.cancel()

    def page_went(self) -> None:
        """End some time after the last page is closed, unless it is loaded again."""
        with self._lock:
            self._pages -= 1
            if not self._pages:
                self._left = threading.Timer(_GRACE, self.closing.set)
                self._left.daemon = True
                self._left.start()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Drop what a browser that went away causes."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version = "HTTP/1.1"
    timeout = 60

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def version_string(self) -> str:
        """Say nothing of what serves."""
        return "beltrami"

    def do_GET(self) -> None:
        name = self._name()
        if name is not None and name.startswith("events/"):
            self._stream(name.removeprefix("events/"))
        elif name is not None and name in self.server.application.files:
            self._send(HTTPStatus.OK, *self.server.application.files[name])
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"")

    def do_POST(self) -> None:
        name = self._name()
        if name is None or not self.headers.get("Origin"):
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"")
            return
        try:
            status, answer = HTTPStatus.OK, self.server.application.answer(name, self._request())
        except MalformedError:
            status, answer = HTTPStatus.BAD_REQUEST, {"message": "the request is malformed"}
        except RefusedError as error:
            status, answer = HTTPStatus.CONFLICT, {"message": str(error)}
        except Exception as error:
            message = f"unexpected error: {type(error).__name__}: {error}"
            status, answer = HTTPStatus.INTERNAL_SERVER_ERROR, {"message": message}
        self._send(status, "application/json", json.dumps(answer).encode())

    def _request(self) -> dict[str, Any]:
        """Return the body of a request; MalformedError if it is truncated, or no JSON object."""
        try:
            length = int(self.headers.get("Content-Length", ""))
            if not 0 < length <= _LONGEST_REQUEST:
                raise MalformedError
            self.connection.settimeout(_BODY_SECONDS)
            body = self.rfile.read(length)
            self.connection.settimeout(self.timeout)
            request = parse_json(body)
        except (ValueError, TimeoutError) as error:
            raise MalformedError from error
        if len(body) < length or not isinstance(request, dict):
            raise MalformedError
        return request

    def _name(self) -> str | None:
        """Return the name that is requested; None if the request is not from a page of this server."""
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        if self.headers.get("Host") != self.server.host or origin not in (None, f"http://{self.server.host}"):
            return None
        token, slash, name = self.path.removeprefix("/").partition("/")
        if not slash and self.server.takes_ticket(token):
            self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", Location=f"/{self.server.token}/")
            raise ConnectionAbortedError
        if not slash or not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return None
        return name if not name or site in ("same-origin", "none") else None

    def _send(self, status: HTTPStatus, kind: str, body: bytes, **more: str) -> None:
        self.send_response(status)
        headers = {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(body)), **more}
        if status != HTTPStatus.OK:
            headers["Connection"] = "close"
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _stream(self, page: str) -> None:
        self.close_connection = True
        events = self.server.application.events_of(page)
        self.server.page_came()
        self.send_response(HTTPStatus.OK)
        for name, value in {**_HEADERS, "Content-Type": "text/event-stream", "Connection": "close"}.items():
            self.send_header(name, value)
        try:
            self.end_headers()
            while not self.server.closing.is_set() and not self._is_gone():
                try:
                    event = events.get(timeout=_BEAT)
                except Empty:
                    continue
                self.wfile.write(f"data: {json.dumps(event)}\n\n".encode())
        except OSError:
            pass
        finally:
            self.server.application.leave(page)
            self.server.page_went()

    def _is_gone(self) -> bool:
        ready, _, _ = select.select([self.connection], [], [], 0)
        return bool(ready) and not self.connection.recv(1, socket.MSG_PEEK)
