"""viser's server behind the checks of `Access`, with limits: what viser itself would accept from anyone."""

from __future__ import annotations

import io
import logging
import socket
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tactile_loc.plugin import ConfigError, MissingLibraryError

from tactile_loc_app.access import Access
from tactile_loc_app.index_page import Visit, brand_page

if TYPE_CHECKING:
    from viser import ViserServer
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Answer = Callable[[ServerConnection, Request], Response | None]

logger = logging.getLogger(__name__)

MOST_CONNECTIONS, MOST_VISITORS = 64, 32
LARGEST_PART, LARGEST_MESSAGE = 4_000_000, 2**16  # bytes; the page uploads files in parts of half a megabyte
SENT = (
    "FileTransferStartUpload",
    "FileTransferPart",
    "TransformControlsUpdateMessage",
    "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
)
"""The messages that this page sends beside those of controls and of the view. Others are dropped.

With some of them, viser would fill the memory, reach other visitors, or open the page to the internet.
"""
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
            "the interactive page needs viser, which is not installed: pip install 'viser>=1.1,<1.2'"
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
    loop = server.get_event_loop()
    loop.call_soon_threadsafe(loop.set_exception_handler, _log_failure)
    return server


def find_visit(server: ViserServer, client_id: int) -> Visit:
    """Return a visitor's visit, as its browser states it."""
    connections: dict[int, Any] = getattr(server._websock_server, "_live_connections", {})
    request = getattr(connections.get(client_id), "request", None)
    return Visit() if request is None else Visit.read(request.path)


def _log_failure(loop: Any, context: dict[str, Any]) -> None:
    """Log a message of a visitor that viser fails on, in one line."""
    logger.warning("a message of a visitor cannot be used (%r)", context.get("exception") or context["message"])


def _is_sent(content: str | bytes) -> bool:
    """Return whether a message is one that the page sends: a control with its value alone, and a view that is seen."""
    from viser._messages import Message

    try:
        message: Any = Message.deserialize(content)  # type: ignore[arg-type]
        match kind := type(message).__name__:
            case "GuiUpdateMessage":
                usable = set(message.updates) == {"value"}
            case "ViewerCameraMessage":
                usable = message.image_height > 0
            case _:
                usable = kind in SENT
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return False
    return usable and (kind == "FileTransferPart" or len(content) <= LARGEST_MESSAGE)


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
        """A connection that takes messages of the page alone, and replaces the oldest without an open websocket."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            others = [one for one in self.server.handlers if one is not self and not one.transport.is_closing()]
            if len(others) >= MOST_CONNECTIONS:
                slow = [one for one in others if one not in self.server.connections]
                min(slow, key=lambda one: one.request is not None).transport.abort()

        async def recv(self, decode: bool | None = None) -> Any:
            while not _is_sent(content := await super().recv(decode)):
                pass
            return content

    def serve_guarded(*args: Any, process_request: Answer, **options: Any) -> Any:
        guarded.append(True)
        limits = {"max_size": LARGEST_PART, "create_connection": Connection}
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
            if response.headers.get("Content-Type", "").startswith("text/html"):
                response.body = brand_page(bytes(response.body), response.headers.get("Content-Encoding") == "gzip")
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
            policy = POLICY.format(host=request.headers["Host"])
            for name, value in {**access.headers, "Content-Security-Policy": policy}.items():
                response.headers[name] = value
        return response

    return answer_allowed
