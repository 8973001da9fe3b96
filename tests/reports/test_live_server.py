"""The view of a live run: permitted requests, answers, and the state of a frame."""

import json
import socket
import threading
import time
from contextlib import suppress
from dataclasses import replace
from http.client import HTTPConnection, HTTPResponse

import numpy as np
import pytest
from message_helpers import missing, naming
from web_visitor import idle_sockets

from tactile_loc import Localizer, LocatedFrame, SourceFrame
from tactile_loc.locate.result.verdict import MEANINGS, Verdict, explain_verdict
from tactile_loc.plugin import ConfigError
from tactile_loc.reports import live_server
from tactile_loc.reports.live_server import Board, LiveServer
from tactile_loc.reports.live_view import describe_frame, make_live_page, render_shape
from tactile_loc.reports.page import JSON_OPTIONS, render
from tactile_loc.tracking.live import LiveResult


def ask(server: LiveServer, path: str, host: str | None = None, **others: str) -> HTTPResponse:
    port = int(server.url.rstrip("/").rpartition(":")[2])
    connection = HTTPConnection("127.0.0.1", port, timeout=120)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}", **others})
    return connection.getresponse()


def events(response: HTTPResponse) -> list[str]:
    return response.read().decode().strip().split("\n\n")


def test_the_page_is_served_locally_and_requests_only_its_own_server(localizer):
    with LiveServer(render(make_live_page(localizer, "<b>camera</b> 0")), 0) as server:
        assert server.url.startswith("http://127.0.0.1:")
        answer = ask(server, "/")
        text = answer.read().decode()
        assert answer.status == 200
        assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        assert "connect-src 'self';" in text
        assert "&lt;b&gt;camera" in text
        assert "<b>camera" not in text
        assert ask(server, "/result.json").status == 404
        for host in ("evil.example:80", "evil.example", "127.0.0.1.evil.example:8420", "127.0.0.1@evil.example"):
            assert ask(server, "/", host).status == 403
            assert ask(server, "/events", host).status == 403
        own = server.url[7:-1].replace("127.0.0.1", "localhost")
        assert ask(server, "/", own, Origin=f"http://{own}").status == 200
        refused = ask(server, "/events", own, Origin="http://evil.example")
        assert (refused.status, refused.read().count(b"\n")) == (403, 1)


def test_a_browser_gets_the_newest_frame_and_the_end_of_the_run():
    with LiveServer("", 0) as server:
        for number in range(3):
            server.board.show(lambda number=number: {"number": number})
        answer = ask(server, "/events")
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        assert answer.readline() == b'data: {"number":2}\n'
        server.board.show(lambda: {"number": 3})
        server.board.end()
        assert events(answer) == ['data: {"number":3}', "event: end\ndata: {}"]


def test_a_state_is_made_only_on_request_and_only_once():
    board, made = Board(), []

    def make() -> dict[str, int]:
        made.append(1)
        return {"number": 1}

    board.show(make)
    assert made == []
    threads = [threading.Thread(target=board.wait_for_newer, args=(0, 10.0)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [1]
    assert board.wait_for_newer(1, 0.01) == (1, "")


def count_open(server: LiveServer) -> int:
    return len(server._server._since)  # connections


def test_idle_connections_keep_nobody_out_and_take_few_files():
    with LiveServer("page", 0) as server, idle_sockets(server._server.server_port, 250) as idle:
        assert ask(server, "/").read() == b"page"
        assert count_open(server) <= live_server.MOST_CONNECTIONS + 1
        assert idle[0].recv(1000).startswith(b"HTTP/1.0 503 ")


def test_too_many_tabs_get_a_message(monkeypatch):
    monkeypatch.setattr(live_server, "MOST_CONNECTIONS", 2)
    with LiveServer("page", 0) as server:
        watching = [ask(server, "/events") for _ in range(2)]
        with idle_sockets(server._server.server_port, 1) as refused:
            assert refused[0].recv(1000).startswith(b"HTTP/1.0 503 ")
        server.board.show(lambda: {"number": 1})
        assert [one.readline() for one in watching] == 2 * [b'data: {"number":1}\n']


def test_connections_without_a_complete_request_end(monkeypatch):
    monkeypatch.setattr(live_server, "REQUEST_S", 1.0)
    with LiveServer("page", 0) as server, idle_sockets(server._server.server_port, 3) as idle:
        watching = ask(server, "/events")
        idle[0].sendall(b"GET / HTTP/1.0\r\n")
        end_s = time.monotonic() + 60
        while count_open(server) > 1 and time.monotonic() < end_s:
            with suppress(OSError):
                idle[0].sendall(b"X: y\r\n")  # a line now and then is not enough
            time.sleep(0.05)
        assert count_open(server) == 1
        server.board.show(lambda: {"number": 1})
        assert watching.readline() == b'data: {"number":1}\n'


def test_an_occupied_port_gives_an_error():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=naming(port, "`port`")):
            LiveServer("", port)
    with pytest.raises(ConfigError, match=naming(70000, "`port`")):
        LiveServer("", 70000)


def state_of(localizer, located: LocatedFrame) -> dict:
    return describe_frame(LiveResult(SourceFrame(9, 1.0, "9.png"), located, None, 3, 12.34), None, localizer)


def test_numbers_are_in_millimetres_and_degrees(localizer):
    T = np.array([[0, -1, 0, 0.0012], [1, 0, 0, -0.0345], [0, 0, 1, 0.0256], [0, 0, 0, 1.0]])
    C = np.diag(np.square([1e-4, 2e-4, 3e-5, *np.radians([0.5, 1.0, 10.0])]))
    located = LocatedFrame(Verdict.CERTAIN, T[None], np.array([0.981]), C, 0.5, 0.1)
    texts = state_of(localizer, located)["texts"]
    assert texts["verdict"] == "certain"
    assert texts["place"] == "1.2, -34.5, 25.6"
    assert texts["place-more"] == "std 0.10, 0.20, 0.03 mm"
    assert texts["turn"] == "90.0°"
    assert not missing(texts["turn-more"], "(0.00, 0.00, 1.00)", "0.5, 1.0, 10.0°")
    assert (texts["probability"], texts["imprint"], texts["rate"]) == ("98 %", "50 %", "12.3 Hz")
    assert not missing(texts["rate-more"], 10, 3)
    less = state_of(localizer, replace(located, covariance=None))["texts"]["turn-more"]
    assert not missing(less, "(0.00, 0.00, 1.00)")
    assert missing(less, "°")
    texts = state_of(localizer, LocatedFrame(Verdict.NO_CONTACT, says="none", seconds=0.1))["texts"]
    assert (texts["verdict"], texts["place"], texts["turn"], texts["says"]) == ("no contact", "-", "-", "none")
    assert texts["verdict-more"] == MEANINGS[Verdict.NO_CONTACT]
    texts = state_of(localizer, LocatedFrame(None, says="damaged", seconds=0.1))["texts"]
    assert (texts["verdict"], texts["verdict-more"]) == ("refused", explain_verdict(None))


@pytest.mark.parametrize("gel", ["rigid", "layer"])
def test_a_frame_shows_its_outline_and_that_of_the_true_pose(store, gel):
    sensor = {"name": "gelslim", "gel": gel}
    localizer = Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, sensor=sensor, store=store)
    touch = localizer.simulate(1, seed=1)[0]
    located = LocatedFrame(Verdict.CERTAIN, touch.T_sensor_object[None], np.ones(1), None, 1.0, 0.1)
    result = LiveResult(SourceFrame(0, 0.0, "0"), located, touch, 0, 0.0)
    made = render_shape(result, localizer)
    assert made.contact_iou(touch.contact_shape, touch.geometry.observed_mask) > 0.97
    state = describe_frame(result, made, localizer)
    assert state["outline"].startswith("M")
    assert state["made"].startswith("M")
    assert state["pictures"][0] is None
    assert state["pictures"][1].startswith("data:image/png;base64,")
    assert json.loads(json.dumps(state, **JSON_OPTIONS)) == state
