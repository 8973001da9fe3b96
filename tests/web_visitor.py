"""A visitor of the page without a browser: requests with chosen headers, and messages of the page's websocket."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, 1.0], "fov": 1.0, "near": 0.1,
    "far": 10.0, "image_height": 100, "image_width": 100, "look_at": [0.0, 0.0, 0.0], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip
UPGRADE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}  # fmt: skip


def ask(port: int, path: str = "/", **headers: str) -> tuple[int, str, Any]:
    """Return the status, the text and the headers of an answer."""
    connection = HTTPConnection("127.0.0.1", port, timeout=120)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    try:
        text = "" if answer.status == 101 else answer.read().decode()
        return answer.status, text, answer.headers
    finally:
        connection.close()


def open_socket(port: int, path: str = "/", **headers: str) -> int:
    """Return the status of the answer to a websocket; 101 if it is open."""
    return ask(port, path, **UPGRADE, **headers)[0]


@contextmanager
def visit(port: int, path: str = "") -> Iterator[ClientConnection]:
    """Open the page's websocket, and look at its view."""
    import viser
    from websockets.sync.client import connect

    with connect(
        f"ws://127.0.0.1:{port}{path}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None
    ) as visitor:
        send(visitor, CAMERA)
        yield visitor


def send(visitor: ClientConnection, message: dict[str, Any]) -> None:
    """Send a message of the page."""
    import msgspec

    visitor.send(msgspec.msgpack.encode(message))


@contextmanager
def idle_sockets(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Open connections that ask for nothing."""
    opened: list[socket.socket] = []
    try:
        for _ in range(count):
            opened.append(socket.create_connection(("127.0.0.1", port), timeout=120))
        yield opened
    finally:
        for one in opened:
            one.close()
