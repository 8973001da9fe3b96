"""The page's server: who is answered, uploads by their stated size, and what visitors leave behind."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from select import select
from socket import SO_RCVBUF, SOL_SOCKET
from typing import Any

import pytest
from tactile_loc import RunConfig

pytest.importorskip("viser")

from tactile_loc.plugin import ConfigError
from web_visitor import CAMERA, ask, idle_sockets, open_socket, send, visit

from tactile_loc_app.guarded_viser import MOST_CONNECTIONS
from tactile_loc_app.server import AppServer
from tactile_loc_app.uploads import LARGEST_MB, MB, MOST_RUNNING

MINI = "gelsight-mini"
CONFIG = RunConfig.from_dict({"object": {"path": "pin"}, "sensor": MINI})


def wait_until(is_done: Callable[[], Any]) -> Any:
    end_s = time.monotonic() + 120
    while not (found := is_done()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return found


@pytest.fixture(scope="module")
def server(store) -> Iterator[AppServer]:
    with AppServer(CONFIG, port=0, store=store) as server:
        yield server


@pytest.fixture(scope="module")
def port(server) -> int:
    return server._server.get_port()


def test_only_own_pages_are_answered_and_connect_to_no_other_server(port):
    host, foreign = f"localhost:{port}", "http://evil.example"
    assert ask(port)[0] == 200
    for headers in ({"Host": f"evil.example:{port}"}, {"Host": host, "Origin": foreign}, {"Origin": f"http://{host}"}):
        status, text, answered = ask(port, **headers)
        assert (status, text.count(".\n"), text.count("\n")) == (403, 1, 1)
        assert "Set-Cookie" not in answered
        assert open_socket(port, **headers) == 403
    assert open_socket(port, Host=host, Origin=f"http://{host}") == 101
    assert open_socket(port, Host=host) == 101
    policy = ask(port)[2]["Content-Security-Policy"]
    assert f"connect-src 'self' ws://127.0.0.1:{port} " in policy
    assert "frame-ancestors 'none'" in policy


def test_other_machines_need_the_token(store):
    with AppServer(CONFIG, host="0.0.0.0", port=0, store=store) as server:
        port = server._server.get_port()
        path = server.url.partition(str(port))[2]
        assert [ask(port)[0], ask(port, "/?token=wrong")[0], open_socket(port)] == [403, 403, 403]
        status, _, answered = ask(port, path)
        assert status == 200
        own = {"Host": f"127.0.0.1:{port}", "Cookie": answered["Set-Cookie"].partition(";")[0]}
        assert ask(port, **own)[0] == 200
        assert open_socket(port, **own) == 403  # no Origin
        assert open_socket(port, **own, Origin=f"http://127.0.0.1:{port}") == 101
        assert open_socket(port, **own, Origin="http://evil.example") == 403


def test_a_host_of_another_machine_is_an_error(store):
    for host in ("203.0.113.7", "nowhere.invalid", ""):
        with pytest.raises(ConfigError):
            AppServer(CONFIG, host=host, store=store)


def test_messages_that_the_page_never_sends_reach_nobody(server, port, caplog):
    import msgspec
    from viser import _messages

    strange = [
        {"type": "GuiFormDirtyMessage", "uuid": "kept for all visitors"},
        {"type": "ShareUrlRequest"},
        {"type": "GuiUpdateMessage", "uuid": "", "updates": {"removed": True}},
        {"type": "GuiUpdateMessage", "uuid": "x" * 2**17, "updates": {"value": ""}},
        {"type": "GuiUpdateMessage"},
        {**CAMERA, "image_height": 0},
        {"type": "none"},
        {},
    ]
    taken: list[str] = []
    kinds = ("GuiFormDirtyMessage", "ShareUrlRequest", "GuiUpdateMessage", "ViewerCameraMessage")
    with visit(port) as visitor:
        connection = wait_until(lambda: next(iter(server.pages.values()), None)).client._websock_connection
        for kind in kinds:
            connection.register_handler(
                getattr(_messages, kind), lambda _, one: taken.append(vars(one).get("uuid", ""))
            )
        for content in (b"", b"\xff\x00", "text", *map(msgspec.msgpack.encode, strange)):
            visitor.send(content)
        send(visitor, {"type": "GuiUpdateMessage", "uuid": "last", "updates": {"value": ""}})
        wait_until(lambda: taken)
    assert taken == ["last"]
    assert not caplog.records


def test_uploads_are_dropped_by_their_stated_size(server, port, monkeypatch):
    shown: list[str] = []
    with visit(port) as visitor:
        page = wait_until(lambda: next(iter(server.pages.values()), None))
        monkeypatch.setattr(page.notices, "notify", lambda title, text, colour="": shown.append(text))
        running = page.client.gui._current_file_upload_states

        def begin(name: str, size: int, parts: int) -> dict[str, str]:
            uuids = {"source_component_uuid": page.upload._impl.uuid, "transfer_uuid": name}
            start = {"filename": name, "mime_type": "", "size_bytes": size, "part_count": parts}
            send(visitor, {"type": "FileTransferStartUpload", **uuids, **start})
            return uuids

        uuids = begin("large.stl", 1_200 * MB, 2)
        wait_until(lambda: len(shown) == 1)
        send(visitor, {"type": "FileTransferPart", **uuids, "part_index": 0, "content": bytes(1000)})
        begin("half.stl", LARGEST_MB * MB // 2, 2)
        begin("more.stl", LARGEST_MB * MB // 2 + 1, 2)
        wait_until(lambda: len(shown) == 2)
        assert set(running) == {"half.stl"}
        uuids = begin("liar.stl", 10, 2)
        send(visitor, {"type": "FileTransferPart", **uuids, "part_index": 0, "content": bytes(1000)})
        wait_until(lambda: len(shown) == 3)
        assert set(running) == {"half.stl"}
        assert f"{LARGEST_MB} MB" in shown[0]
        begin("negative.stl", -1_200 * MB, 2)
        begin("pieces.stl", MB, 10**6)
        for number in range(MOST_RUNNING):
            begin(f"{number}.stl", 10, 1)
        wait_until(lambda: len(shown) == 6)
        assert set(running) == {"half.stl", *(f"{number}.stl" for number in range(MOST_RUNNING - 1))}
        running.clear()
        uuids = begin("small.stl", 4, 1)
        send(visitor, {"type": "FileTransferPart", **uuids, "part_index": 0, "content": b"mesh"})
        wait_until(lambda: len(shown) == 7)  # it is no mesh
        assert page.upload.value.content == b""


def test_a_visit_that_is_loaded_again_keeps_its_session_and_two_tabs_stay_apart(server, port):
    name = "0123456789abcdef" * 2
    with visit(port, f"/?visit={name}"):
        (first,) = wait_until(lambda: list(server.pages.values()))
        with visit(port, f"/?visit={name}"):
            wait_until(lambda: len(server.pages) == 2)
            other = next(page for page in server.pages.values() if page is not first)
            assert other.session is not first.session
        wait_until(lambda: len(server.pages) == 1)
    wait_until(lambda: not server.pages)
    assert first.session.folder.is_dir()
    wait_until(lambda: not other.session.folder.exists())  # one session is kept for a visit
    with visit(port, f"/?visit={name}"):
        (again,) = wait_until(lambda: list(server.pages.values()))
        assert again.session is first.session
    with visit(port, "/?visit=another"):  # no number of a visit
        (fresh,) = wait_until(lambda: [page for page in server.pages.values() if page is not again])
        assert fresh.session is not first.session
    wait_until(lambda: not server.pages and not fresh.session.folder.exists())
    server.forget_left(0.0)
    assert not first.session.folder.exists()


def test_a_visitor_who_leaves_while_the_page_is_made_keeps_the_session(server, port, monkeypatch):
    name = "ffeeddccbbaa99887766554433221100"
    with visit(port, f"/?visit={name}"):
        (first,) = wait_until(lambda: list(server.pages.values()))
    wait_until(lambda: not server.pages)
    failed = []
    with monkeypatch.context() as changed:
        changed.setattr(type(first), "_add_controls", lambda page: failed.append(page) or 1 / 0)
        with visit(port, f"/?visit={name}"):
            wait_until(lambda: failed and name in server._kept)
    assert first.session.folder.is_dir()
    with visit(port, f"/?visit={name}"):
        (again,) = wait_until(lambda: list(server.pages.values()))
        assert again.session is first.session
    wait_until(lambda: not server.pages)
    server.forget_left(0.0)


def test_of_two_sessions_without_touches_the_older_one_is_kept(server, port, monkeypatch):
    monkeypatch.setattr("tactile_loc_app.server.MOVE_S", 0.0)
    name = "00112233445566778899aabbccddeeff"
    with ExitStack() as later:
        with visit(port, f"/?visit={name}"):
            (first,) = wait_until(lambda: list(server.pages.values()))
            later.enter_context(visit(port, f"/?visit={name}"))
            (other,) = wait_until(lambda: [page for page in server.pages.values() if page is not first])
        wait_until(lambda: list(server.pages.values()) == [other])
    wait_until(lambda: not server.pages and not other.session.folder.exists())
    assert first.session.folder.is_dir()
    server.forget_left(0.0)


def test_a_page_that_is_loaded_again_waits_for_its_earlier_connection(server, port, monkeypatch):
    monkeypatch.setattr("tactile_loc_app.server.MOVE_S", 0.0)
    name = "fedcba9876543210" * 2
    with ExitStack() as later:
        with visit(port, f"/?visit={name}"):
            (first,) = wait_until(lambda: list(server.pages.values()))
            later.enter_context(visit(port, f"/?visit={name}&again=1"))
            wait_until(lambda: len(server._server.get_clients()) == 2)
            assert list(server.pages.values()) == [first]
        (again,) = wait_until(lambda: [page for page in server.pages.values() if page is not first])
        assert again.session is first.session
    wait_until(lambda: not server.pages)
    server.forget_left(0.0)


def test_visitors_who_leave_at_once_leave_nothing(server, port):
    for _ in range(16):
        with visit(port):
            pass
    folder = Path(server.localizers.folder)
    wait_until(lambda: not server.pages and not list(folder.glob("visitor-*")))
    wait_until(lambda: "follower" not in {thread.name for thread in threading.enumerate()})


@pytest.mark.parametrize("request_line", ["", "GET / HTTP/1.1\r\nHost: localhost:{}\r\n\r\n"], ids=["idle", "deaf"])
def test_connections_that_wait_keep_nobody_out(port, request_line):
    with idle_sockets(port, 250) as idle:
        for one in idle:
            with suppress(OSError):  # it is cut already
                one.setsockopt(SOL_SOCKET, SO_RCVBUF, 2048)  # the page does not fit, and is not taken
                one.sendall(request_line.format(port).encode())
        assert ask(port)[0] == 200
        closed = idle[: len(idle) - MOST_CONNECTIONS]
        assert [one for one in closed if not select([one], [], [], 120)[0]] == []
        assert open_socket(port) == 101
