"""The server of the page, on viser: each visitor has a session, and all sessions share localizers."""

from __future__ import annotations

import io
import tempfile
import time
from contextlib import redirect_stdout, suppress
from pathlib import Path
from threading import RLock
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from tactile_loc import RunConfig, StageStore
from tactile_loc.plugin import ConfigError

from tactile_loc_app.access import Access
from tactile_loc_app.guarded_viser import find_visit, require_viser, start_viser
from tactile_loc_app.index_page import Visit
from tactile_loc_app.session import Session
from tactile_loc_app.shared_localizers import SharedLocalizers

if TYPE_CHECKING:
    from viser import ClientHandle

    from tactile_loc_app.page.panels import VisitorPage

HOST, PORT = "127.0.0.1", 8080
KEPT_S, MOST_KEPT = 900.0, 8  # time for which the session of a visitor who left is kept, and number of such sessions
RELOAD_S = 30.0  # time within which a browser that loads the page again ends its earlier connection
MOVE_S = 2.0  # the same for a browser that opens the page's address; a second tab waits so long for its session


class AppServer:
    """Serves the page until it is closed. `pages` are those of the visitors, by viser's number of the client.

    `config` names the first object and sensor. Each visitor's files are kept in a temporary folder. When a visitor
    leaves, the session is kept for KEPT_S seconds, so that the page can be loaded again. Raises TactileLocError if the
    object or the sensor cannot be used, ConfigError for a wrong host or port, and MissingLibraryError without viser.
    """

    def __init__(
        self, config: RunConfig | None = None, host: str = HOST, port: int = PORT, store: StageStore | None = None
    ) -> None:
        require_viser()
        if not 0 <= port <= 65535:
            raise ConfigError(f"the port cannot be {port}; give a number from 0 to 65535")
        self._folder = tempfile.TemporaryDirectory(prefix="tactile-loc-app-", ignore_cleanup_errors=True)
        self.access = Access.at(host)
        self.localizers = SharedLocalizers(Path(self._folder.name), store)
        self.config = config
        self.pages: dict[int, VisitorPage] = {}
        self._visits: dict[int, str] = {}
        self._kept: dict[str, tuple[Session, float]] = {}
        self._lock = RLock()
        self.new_session().close()  # raises here, not when the first visitor comes
        self._server = start_viser(host, port, self.access)
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._leave)

    @property
    def url(self) -> str:
        """The address of the page, with its token if other machines reach it."""
        return self.access.write_url(self._server.get_host(), self._server.get_port())

    @property
    def is_open(self) -> bool:
        """Whether other machines reach the page, under each of this machine's names."""
        return Access.is_everywhere(self._server.get_host())

    def new_session(self) -> Session:
        """Return the session of a new visitor."""
        return Session(self.localizers, self.config)

    def _welcome(self, client: ClientHandle) -> None:
        from tactile_loc_app.page.panels import VisitorPage

        if not self._is_here(client):
            return
        visit = find_visit(self._server, client.client_id)
        session = self._find_session(visit)
        try:
            page = VisitorPage(client, session)
        except BaseException:  # the visitor may have left
            self._close(self._keep(visit.number, session))
            raise
        with self._lock:
            self.pages[client.client_id], self._visits[client.client_id] = page, visit.number
        if not self._is_here(client):  # left meanwhile, and maybe before the page was known
            self._leave(client)

    def _find_session(self, visit: Visit) -> Session:
        """Return the session that a visit left, or a new one. A visit that goes on in another tab is not shared."""
        end_s = time.monotonic() + (RELOAD_S if visit.is_again else MOVE_S)
        while visit.number:
            with self._lock:
                if visit.number in self._kept:
                    return self._kept.pop(visit.number)[0]
                is_open = visit.number in self._visits.values()
            if not is_open or time.monotonic() > end_s:
                break
            time.sleep(0.05)
        return self.new_session()

    def _is_here(self, client: ClientHandle) -> bool:
        return client.client_id in self._server.get_clients()

    def _leave(self, client: ClientHandle) -> None:
        with self._lock:
            page, visit = self.pages.pop(client.client_id, None), self._visits.pop(client.client_id, "")
            if page is None:
                return
            gone = self._keep(visit, page.session)
        page.close()
        self._close(gone)

    def _keep(self, visit: str, session: Session) -> list[Session]:
        """Keep the session of a visit, and return the sessions that are not kept.

        Of two sessions of a visit, the one with more touches is kept, or the older one.
        """
        with self._lock:
            if not visit:
                return [session]
            before = [self._kept.pop(visit)[0]] if visit in self._kept else []
            kept, *gone = sorted([session, *before], key=lambda one: (-len(one.touches), one.begin_s))
            self._kept[visit] = kept, time.monotonic()
            return gone

    def _close(self, gone: list[Session]) -> None:
        """Close sessions that are not kept, and those of visitors who left long ago."""
        for session in gone:
            session.close()
        self.forget_left(KEPT_S)

    def forget_left(self, after_s: float) -> None:
        """Close the sessions of visitors who left `after_s` seconds ago, and the oldest if there are too many."""
        end_s = time.monotonic() - after_s
        with self._lock:
            old = list(self._kept)[: max(len(self._kept) - MOST_KEPT, 0)]
            old += [visit for visit, (_, left_s) in self._kept.items() if left_s <= end_s and visit not in old]
            gone = [self._kept.pop(visit)[0] for visit in old]
        for session in gone:
            session.close()

    def serve(self) -> None:
        """Serve the page until Ctrl-C."""
        with suppress(KeyboardInterrupt):
            while True:
                time.sleep(3600)

    def close(self) -> None:
        """End the server, and remove the uploaded files."""
        with redirect_stdout(io.StringIO()):  # viser prints a line
            self._server.stop()
        with self._lock:
            left, kept = list(self.pages.values()), [session for session, _ in self._kept.values()]
            self.pages.clear()
            self._kept.clear()
        for page in left:
            page.close()
        for session in (*kept, *(page.session for page in left)):
            session.close()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> Any:
        self.close()
