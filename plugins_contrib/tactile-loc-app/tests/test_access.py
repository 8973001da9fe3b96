"""Which requests a local server answers: its own names and pages, and the token of a server that others reach."""

import socket
from email.message import Message

import pytest

from tactile_loc_app.access import Access, is_loopback

OPEN = Access.at("0.0.0.0")
OWN = socket.gethostname().lower().partition(".")[0]


def headers(**values: str) -> Message:
    message = Message()
    for name, value in values.items():
        message[name] = value
    return message


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8420", "[::1]:1", "LOCALHOST:80"])
def test_own_pages_are_answered(host):
    access = Access.at("127.0.0.1")
    assert access.token == ""
    assert access.find_fault("/", headers(Host=host)) == ""
    assert access.find_fault("/", headers(Host=host, Origin=f"http://{host}"), connects=True) == ""
    assert access.find_fault("/", headers(Host=host), connects=True) == ""  # no browser


@pytest.mark.parametrize(
    "host",
    ["", "evil.example", "127.0.0.1.evil.example", "127.0.0.1@evil.example", "192.168.0.7:80", "localhost:x", OWN],
)
def test_a_foreign_or_second_or_missing_host_is_refused(host):
    own = Access.at("localhost")
    assert own.find_fault("/", headers(Host=host))
    second = headers(Host="localhost")
    second["Host"] = "localhost"
    assert own.find_fault("/", second)
    assert own.find_fault("/", headers())


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://localhost:3000", "http://127.0.0.1:8080", "https://localhost:8080", ""],
)
def test_a_foreign_page_is_refused(origin):
    for access in (Access.at("localhost"), OPEN):
        assert access.find_fault(f"/?token={access.token}", headers(Host="localhost:8080", Origin=origin))


@pytest.mark.parametrize("name", ["192.168.0.7:8080", "[fe80::1]:8080", f"{OWN}:80", f"{OWN}.local", "localhost"])
def test_other_machines_need_the_token(name):
    path, origin = f"/?token={OPEN.token}", f"http://{name}"
    assert OPEN.find_fault("/", headers(Host=name))
    for wrong in ("wrong", "\udcff", "%ff", ""):
        assert OPEN.find_fault(f"/?token={wrong}", headers(Host=name))
    assert OPEN.find_fault(path, headers(Host=name)) == ""
    kept = OPEN.headers["Set-Cookie"].partition(";")[0]
    assert OPEN.find_fault("/a.js", headers(Host=name, Cookie=f"a=b; {kept}")) == ""
    assert OPEN.find_fault("/", headers(Host=name, Cookie=f"{kept}x"))
    assert OPEN.find_fault(path, headers(Host=name), connects=True)  # no Origin
    assert OPEN.find_fault(path, headers(Host=name, Origin=origin), connects=True) == ""
    assert OPEN.find_fault(path, headers(Host="evil.example", Origin="http://evil.example"))


def test_a_machine_without_a_name_has_no_empty_name(monkeypatch):
    monkeypatch.setattr(socket, "gethostname", str)
    access = Access.at("0.0.0.0")
    for host in ("", ".evil.example", "<>"):
        assert access.find_fault(f"/?token={access.token}", headers(Host=host))


def test_each_open_server_has_its_own_token_and_address():
    assert len({Access.at("0.0.0.0").token for _ in range(3)} - {""}) == 3
    assert OPEN.write_url("0.0.0.0", 80) == f"http://127.0.0.1:80/?token={OPEN.token}"
    assert Access.at("::1").write_url("::1", 80) == "http://[::1]:80"
    assert [is_loopback(host) for host in ("127.0.0.2", "::1", "::", "robot", "")] == [True, True, False, False, False]
