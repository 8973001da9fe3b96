"""`tactile-loc app`: press a virtual finger and locate an object on a local web page."""

from __future__ import annotations

import sys
from typing import Annotated, Any

from tactile_loc_cli import options
from tactile_loc_cli.console import say
from tactile_loc_cli.options import RunOptions

HOST, PORT = "127.0.0.1", 8080

Given = Annotated[RunOptions, options.Takes("object", "units", "symmetry", "sensor")]
Port = Annotated[
    int, options.declare("--port", "N", f"Port of the page; if it is taken, the next free one. Default: {PORT}.",
                         min=0, max=65535, show_default=False)
]  # fmt: skip
Host = Annotated[
    str,
    options.declare(
        "--host", "ADDRESS", f"Address at which the page is served; 0.0.0.0 serves it to the network. Default: {HOST}.",
        show_default=False,
    ),
]  # fmt: skip


def app(*, given: Given, host: Host = HOST, port: Port = PORT, store: options.Store = None) -> dict[str, Any]:
    """Press a virtual finger on an object, and locate it, on a local web page.

    The page takes own meshes, sensors and touches. The result can be downloaded with a Python script that computes it
    again. The command ends with Ctrl-C.
    """
    from tactile_loc.app.server import AppServer
    from tactile_loc.store.store import StageStore

    settings = options.make_config(given)
    with AppServer(settings.object, settings.sensor, host, port, StageStore(store)) as server:
        say(f"page: {server.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        server.serve()
    return {"url": server.url}
