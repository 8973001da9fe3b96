"""Which requests a local web server answers: those of its own pages and, from other machines, those with its token.

A browser sends the address that it believes to visit (`Host`) and the page that asks (`Origin`). A foreign page cannot
forge them, but a name of its own may lead to this machine (DNS rebinding), and it may open a websocket to any address.
"""

from __future__ import annotations

import hmac
import re
import secrets
import socket
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Protocol
from urllib.parse import parse_qs

LOOPBACK = frozenset({"localhost", "127.0.0.1", "[::1]"})
EVERYWHERE = ("0.0.0.0", "::")  # addresses that stand for all of a machine
TOKEN_BYTES = 24
SAFE = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
_HOST = re.compile(r"(?P<name>\[[\da-f:.]+\]|[\w.-]+)(?::\d{1,5})?", re.ASCII)


class Headers(Protocol):
    """The headers of a request, as the libraries for websockets and for HTTP give them."""

    def get_all(self, name: str, /) -> list[str] | None:
        """Return all values of a header."""


@dataclass(frozen=True)
class Access:
    """The names under which a server may be visited, and the token that visitors need; "" if none.

    Only a server that other machines reach has a token, which is part of the address that the command prints. The
    browser keeps it as a cookie.
    """

    names: frozenset[str]
    token: str = ""

    @classmethod
    def at(cls, host: str) -> Access:
        """Return the access of a server that listens at an address or a name."""
        name = write_host(host)
        if is_loopback(host):
            return cls(LOOPBACK | {name})
        own = socket.gethostname().lower().partition(".")[0]
        return cls((LOOPBACK | {name, own}) - {""}, secrets.token_urlsafe(TOKEN_BYTES))

    @staticmethod
    def is_everywhere(host: str) -> bool:
        """Return whether an address stands for all of a machine, so that other machines reach the server."""
        return host in EVERYWHERE

    def find_fault(self, path: str, headers: Headers, connects: bool = False) -> str:
        """Return why a request is refused, in one sentence, or "". `connects` tells that it opens a websocket."""
        hosts, origins = (headers.get_all(name) or [] for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0].lower()):
            return "This server has another name; open the address that the command printed."
        if [one.lower() for one in origins] not in ([], [f"http://{hosts[0].lower()}"]):
            return "A page of another server asks; open the address that the command printed."
        if self.token and not self._has_token(path, headers):
            return "The token is missing or wrong; open the whole address that the command printed."
        if self.token and connects and not origins:
            return "The request names no Origin, which is needed from other machines; use a browser."
        return ""

    def _is_own(self, host: str) -> bool:
        """Return whether a host is one of the names. From other machines, so is an address, or a name in a domain."""
        found = _HOST.fullmatch(host)
        name = "" if found is None else found["name"]
        return name in self.names or (self.token != "" and (_is_address(name) or name.partition(".")[0] in self.names))

    def _has_token(self, path: str, headers: Headers) -> bool:
        asked = parse_qs(path.partition("?")[2]).get("token", [])
        cookies = [one.strip().partition("=") for line in headers.get_all("Cookie") or [] for one in line.split(";")]
        given = [*asked, *(value for name, _, value in cookies if name == self._cookie)]
        return any(hmac.compare_digest(one.encode(errors="replace"), self.token.encode()) for one in given)

    @property
    def _cookie(self) -> str:
        return f"tactile-loc-{self.token[:6]}"  # servers on other ports of a machine get the same cookies

    @property
    def headers(self) -> dict[str, str]:
        """The headers of an answer that is no refusal: a browser keeps the token, and shows it to no other server."""
        kept = {"Set-Cookie": f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"} if self.token else {}
        return {**SAFE, **kept}

    def write_url(self, host: str, port: int) -> str:
        """Return the address of the page, with its token. An address of all of a machine is replaced by 127.0.0.1."""
        name = "127.0.0.1" if host in EVERYWHERE else write_host(host)
        return f"http://{name}:{port}" + (f"/?token={self.token}" if self.token else "")


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address or a name."""
    return host.lower() == "localhost" or (_is_address(host) and ip_address(host.strip("[]")).is_loopback)


def write_host(host: str) -> str:
    """Return an address or a name as it is written in a URL: an IPv6 address in brackets."""
    return f"[{host}]".lower() if ":" in host and not host.startswith("[") else host.lower()


def _is_address(name: str) -> bool:
    try:
        ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True
