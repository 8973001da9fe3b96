"""viser's server behind the checks of `Access`, with limits: what viser itself would accept from anyone."""

from __future__ import annotations

import io
import socket
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tactile_loc.core.errors import ConfigError, MissingLibraryError
from tactile_loc.reports.access import Access

if TYPE_CHECKING:
    from viser import ViserServer
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Answer = Callable[[ServerConnection, Request], Response | None]

MOST_CONNECTIONS, MOST_VISITORS = 64, 32
LARGEST_MESSAGE = 4_000_000  # bytes; the page uploads files in parts of half a megabyte
POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; object-src 'none'; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' ws://{host} data: blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""The page loads nothing from other servers, connects to no other one, and is part of no other page."""
_starting = Lock()


def require_viser() -> ModuleType:
    """Return viser. Raises MissingLibraryError if it is not installed."""
    try:
        import viser
    except ImportError as error:
        raise MissingLibraryError(
            "the interactive page needs viser, which is not installed: pip install 'tactile-loc[app]'"
        ) from error
    return viser


def start_viser(host: str, port: int, access: Access) -> ViserServer:
    """Start viser's server, which answers only what `access` allows. If the port is taken, the next free one is used.

    Raises MissingLibraryError without a suitable viser, and ConfigError for a host that is not of this machine.
    """
    viser = require_viser()
    _require_host(host)
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # the visitor has left
    with redirect_stdout(io.StringIO()), _guard_sockets(access) as guarded:  # viser prints a banner
        server = viser.ViserServer(host, port, label="tactile-loc", verbose=False)
        if not guarded:
            server.stop()
            raise MissingLibraryError(f"viser {viser.__version__} cannot be guarded; install viser 1.1.1")
    for message in (viser._messages.ShareUrlRequest, viser._messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)  # it would open the page to the internet
    return server


def _require_host(host: str) -> None:
    """Raise ConfigError if no server can listen at a host; viser would try forever."""
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(host or "-", 0, type=socket.SOCK_STREAM):
            with socket.socket(family, kind, protocol) as one:
                one.bind(address)
    except (OSError, UnicodeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"the page cannot be served at {host!r} ({reason}); choose another `host`") from error


@contextmanager
def _guard_sockets(access: Access) -> Iterator[list[bool]]:
    """Guard the websockets server that viser starts during the block. The list is empty if it started none."""
    from websockets.asyncio import server as sockets

    serve, guarded = sockets.serve, list[bool]()

    class Connection(sockets.ServerConnection):
        """A connection that replaces the oldest one without a request if there are too many."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            opened = [one for one in self.server.handlers if not one.transport.is_closing()]
            if len(opened) > MOST_CONNECTIONS:
                next(one for one in opened if one.request is None).transport.abort()

    def serve_guarded(*args: Any, process_request: Answer, **options: Any) -> Any:
        guarded.append(True)
        limits = {"max_size": LARGEST_MESSAGE, "create_connection": Connection}
        return serve(*args, process_request=_guard(process_request, access), **{**options, **limits})

    with _starting:
        sockets.serve = serve_guarded  # type: ignore[assignment,misc]
        try:
            yield guarded
        finally:
            sockets.serve = serve  # type: ignore[misc]


def _guard(answer: Answer, access: Access) -> Answer:
    """Return viser's answers to requests, and refusals of those that `access` does not allow."""

    def answer_allowed(connection: ServerConnection, request: Request) -> Response | None:
        connects = request.headers.get("Upgrade") is not None
        if fault := access.find_fault(request.path, request.headers, connects):
            return connection.respond(403, f"{fault}\n")
        if connects and len(connection.server.connections) >= MOST_VISITORS:
            return connection.respond(503, "There are too many visitors; close some tabs of this page.\n")
        response = answer(connection, request)
        if response is not None:
            policy = POLICY.format(host=request.headers["Host"])
            for name, value in {**access.headers, "Content-Security-Policy": policy}.items():
                response.headers[name] = value
        return response

    return answer_allowed
