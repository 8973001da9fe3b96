"""A small local web server for live runs: it serves the page, and sends each new frame as an event.

The server listens only on 127.0.0.1, and answers only its own pages. Idle and slow connections are cut, so that the run
never lacks files.
"""

from __future__ import annotations

import json
import logging
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.reports.page import JSON_OPTIONS

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
SAFE = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
OWN_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?", re.ASCII)
ALIVE_S = 10.0  # longest time between two messages to a browser
SHORTEST_S = 0.1  # shortest time between two frames
LAST_S = 1.0  # longest wait until all browsers have received the end
MOST_CONNECTIONS = 32
REQUEST_S, SEND_S = 5.0, 10.0  # longest times for a browser's request, and for a message to a slow browser

MakeState = Callable[[], dict[str, Any]]


class Board:
    """The newest state of the page, for all browsers. Its JSON is made when the first browser asks for the state."""

    def __init__(self) -> None:
        self._changed, self._making = threading.Condition(), threading.Lock()
        self._version = 0
        self._make: MakeState = dict  # an empty state
        self._made = 0, ""
        self._watchers = 0
        self.ended = False

    def show(self, make: MakeState) -> None:
        """Replace the state with the result of `make`."""
        with self._changed:
            self._version, self._make = self._version + 1, make
            self._changed.notify_all()

    def end(self) -> None:
        """Announce the end, and wait up to LAST_S seconds until all browsers have received it."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._watchers, LAST_S)

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Count one more watching browser until the block ends."""
        with self._changed:
            self._watchers += 1
        try:
            yield
        finally:
            with self._changed:
                self._watchers -= 1
                self._changed.notify_all()

    def wait_for_newer(self, version: int, timeout_s: float) -> tuple[int, str]:
        """Wait up to `timeout_s` seconds for a state newer than `version`, and return its version and JSON.

        If no newer state comes, return `version` and an empty text.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._version > version or self.ended, timeout_s)
            newest, make = self._version, self._make
        if newest == version:
            return version, ""
        with self._making:
            if self._made[0] < newest:
                self._made = newest, json.dumps(make(), **JSON_OPTIONS)
            return self._made


class LiveServer:
    """Context manager that serves an HTML page at `url`, and sends the states of its `board` to browsers.

    Port 0 selects a free port. Raises ConfigError if the port is in use or not allowed.
    """

    def __init__(self, page: str, port: int) -> None:
        self.board = Board()
        handler = type("Handler", (_Handler,), {"page": page.encode(), "board": self.board})
        try:
            self._server = _Server((HOST, port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise ConfigError(
                f"the view cannot use port {port} ({reason}); choose another `port`, or 0 for a free one"
            ) from error
        self.url = f"http://{HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="view", daemon=True)

    def __enter__(self) -> LiveServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.board.end()
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = 128  # with a short queue, a browser may wait for seconds

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._changed = threading.Condition()
        self._since: dict[Any, float] = {}  # when each open connection came; infinite once it has asked for something
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection. If there are too many, cut the one that has waited longest without a request."""
        with self._changed:
            self._since[request] = time.monotonic()
            oldest = min(self._since, key=self._since.__getitem__)
            too_many = len(self._since) > MOST_CONNECTIONS
        if too_many:
            self._cut(oldest, "There are too many connections to this page; close some of its tabs.")
            if oldest is request:
                self.shutdown_request(request)
                return
            with self._changed:
                self._changed.wait_for(lambda: oldest not in self._since, SHORTEST_S)
        super().process_request(request, client_address)

    def begin_answer(self, request: Any) -> None:
        """Note that a connection has asked for something."""
        with self._changed:
            self._since[request] = float("inf")

    def service_actions(self) -> None:
        """Cut connections that have waited too long without a request."""
        with self._changed:
            late = [one for one, since in self._since.items() if time.monotonic() - since > REQUEST_S]
        for request in late:
            self._cut(request, "The request took too long.")

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._changed:
            self._since.pop(request, None)
            self._changed.notify_all()
        super().shutdown_request(request)

    def _cut(self, request: Any, reason: str) -> None:
        status = f"HTTP/1.0 {HTTPStatus.SERVICE_UNAVAILABLE} Unavailable"
        with suppress(OSError):
            request.sendall(f"{status}\r\nContent-Type: text/plain\r\n\r\n{reason}\n".encode())
            request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error, unless the browser closed the connection."""
        error = sys.exception()
        if not isinstance(error, (ConnectionError, TimeoutError)):
            logger.error("the view cannot show a frame (%s: %s)", type(error).__name__, error)


class _Handler(BaseHTTPRequestHandler):
    page: bytes
    board: Board
    server: _Server
    timeout = SEND_S

    def do_GET(self) -> None:
        """Answer with the page or with a stream of events."""
        self.server.begin_answer(self.connection)
        if fault := self._find_fault():
            self._begin("text/plain", len(fault) + 1, HTTPStatus.FORBIDDEN)
            self.wfile.write(f"{fault}\n".encode())
        elif self.path == "/":
            self._begin("text/html; charset=utf-8", len(self.page))
            self.wfile.write(self.page)
        elif self.path == "/events":
            self._begin("text/event-stream; charset=utf-8")
            with self.board.watch():
                for event in self._generate_events():
                    self.wfile.write(event.encode())
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _find_fault(self) -> str:
        """Return why a request is refused, in one sentence, or "".

        A browser sends the address that it believes to visit (`Host`) and the page that asks (`Origin`). A foreign page
        cannot forge them, but a name of its own may lead to this machine (DNS rebinding).
        """
        hosts, origins = ([value.lower() for value in self.headers.get_all(name) or []] for name in ("Host", "Origin"))
        if len(hosts) != 1 or not OWN_HOST.fullmatch(hosts[0]):
            return "This server has another name; open the address that the command printed."
        if origins not in ([], [f"http://{hosts[0]}"]):
            return "A page of another server asks; open the address that the command printed."
        return ""

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, so that requests do not appear in the terminal."""

    def _begin(self, kind: str, length: int | None = None, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        lengths = {} if length is None else {"Content-Length": str(length)}
        for name, value in {"Content-Type": kind, **lengths, **SAFE}.items():
            self.send_header(name, value)
        self.end_headers()

    def _generate_events(self) -> Iterator[str]:
        """Yield an event for each new state and for the end. In a longer pause, yield a comment as a sign of life."""
        version, pause = 0, threading.Event()
        while True:
            ended = self.board.ended
            newest, text = self.board.wait_for_newer(version, ALIVE_S)
            if newest > version:
                yield f"data: {text}\n\n"
                pause.wait(SHORTEST_S)
            elif ended:
                yield "event: end\ndata: {}\n\n"
                return
            else:
                yield ": alive\n\n"
            version = newest
