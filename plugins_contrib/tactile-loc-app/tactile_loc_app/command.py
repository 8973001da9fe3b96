"""`tactile-loc app`: press a virtual finger and locate an object on a local web page."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any

from tactile_loc.commands import RunOptions, Store, Takes, declare, make_config, say

HOST, PORT = "127.0.0.1", 8080

Given = Annotated[RunOptions, Takes("object", "units", "symmetry", "sensor")]
PORT_HELP = f"Port of the page; if it is taken, the next free one. Default: {PORT}."
HOST_HELP = (
    "Address at which the page is served; 0.0.0.0 serves it to other machines, which need the token in the printed "
    f"address. Default: {HOST}."
)
Port = Annotated[int, declare("--port N", PORT_HELP, min=0, max=65535, show_default=False)]
Host = Annotated[str, declare("--host ADDRESS", HOST_HELP, show_default=False)]


@contextmanager
def _end_like_ctrl_c() -> Iterator[None]:
    """Let SIGTERM act as Ctrl-C in the block, so that the files of visitors are removed."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def app(*, given: Given, host: Host = HOST, port: Port = PORT, store: Store = None) -> dict[str, Any]:
    """Press a virtual finger on an object, and locate it, on a local web page.

    The page takes own meshes, sensors and touches. The result can be downloaded with a Python script that computes it
    again. The command ends with Ctrl-C.
    """

    from tactile_loc import StageStore

    from tactile_loc_app.server import AppServer

    chosen = make_config(given), host, port, StageStore(store)
    # a signal may come as soon as the address is printed
    with _end_like_ctrl_c(), AppServer(*chosen) as server, suppress(KeyboardInterrupt):
        say(f"page: {server.url} (Ctrl-C ends it)")
        if server.is_open:
            say("on other machines, write the name or the address of this machine instead of 127.0.0.1")
        sys.stdout.flush()
        server.serve()
    return {"url": server.url}
