"""The card over the view: the verdict as a coloured badge with one sentence, or the progress of a long work."""

from __future__ import annotations

import html
import time
from typing import TYPE_CHECKING

from tactile_loc import Localization, Palette
from tactile_loc.commands import format_percent

if TYPE_CHECKING:
    from viser import ClientHandle

PALETTE = Palette()
SIGNS = {"certain": "\N{CHECK MARK}", "ambiguous": "?", "no contact": "\N{EN DASH}"}
OTHER_SIGN = "!"
NARROW = "\N{NO-BREAK SPACE}"
CARD = (
    "position:fixed;left:20px;top:20px;z-index:50;max-width:min(30rem,calc(100vw - 40px));display:flex;gap:12px;"
    "align-items:center;padding:10px 14px;border-radius:10px;background:#fffffff0;font:15px/1.35 sans-serif;"
    f"box-shadow:0 2px 12px #0003;pointer-events:none;color:{PALETTE.ink}"
)
BADGE = "padding:5px 14px;border-radius:8px;color:#fff;font-weight:700;font-size:17px;white-space:nowrap;background:{}"
BAR = "height:6px;border-radius:3px;margin-top:7px;background:linear-gradient(90deg,{best} {share}%,{line} {share}%)"


class Overlay:
    """Shows one card over the view of a visitor."""

    def __init__(self, client: ClientHandle) -> None:
        self._handle = client.gui.add_html("")
        self._begin_s = 0.0

    def clear(self) -> None:
        """Remove the card."""
        self._handle.content = ""

    def show_hint(self, text: str) -> None:
        """Show a sentence."""
        self._handle.content = f'<div id="card" style="{CARD}"><div>{html.escape(text)}</div></div>'

    def show_result(self, found: Localization) -> None:
        """Show the verdict and its meaning."""
        verdict = str(found.verdict)
        sign, badge = SIGNS.get(verdict, OTHER_SIGN), BADGE.format(PALETTE.find_verdict(verdict))
        self._handle.content = (
            f'<div id="card" style="{CARD}"><span style="{badge}">{sign}&nbsp;{html.escape(verdict)}</span>'
            f"<div>{html.escape(describe_verdict(found).replace(' %', NARROW + '%'))}</div></div>"
        )

    def begin(self, text: str) -> None:
        """Show that a long work begins."""
        self._begin_s = time.monotonic()
        self.show_progress(text, 0.0)

    def show_progress(self, text: str, share: float) -> None:
        """Show a task, its share, 0 to 1, and the remaining time once it can be estimated."""
        passed_s = time.monotonic() - self._begin_s
        left = f", about {write_seconds(passed_s * (1 - share) / share)} left" if share > 0.05 else ""
        bar = BAR.format(best=PALETTE.best, line=PALETTE.line, share=round(100 * share))
        inside = f'{html.escape(text + left)}<div style="{bar}"></div>'
        self._handle.content = f'<div id="card" style="{CARD}"><div style="min-width:16rem">{inside}</div></div>'


def write_seconds(seconds: float) -> str:
    """Return a duration in words."""
    return f"{max(1, round(seconds))} s" if seconds < 90 else f"{round(seconds / 60)} min"


def describe_verdict(found: Localization) -> str:
    """Return one sentence: how sure the first pose is, or what to do."""
    touches = len(found.touches)
    base = f"{touches} touch{'' if touches == 1 else 'es'}: "
    share, one_fits = found.probability_within(), len(found.equal_explanations) == 1
    within = "" if share is None else f"within {found.tolerance.describe()} with {format_percent(share)} probability"
    if str(found.verdict) == "certain" and within:
        return f"{base}the pose is {within}."
    if str(found.verdict) == "ambiguous":
        state = f"the first pose is {within}" if one_fits and within else found.count_explanations()
        return f"{base}{state}. Touch again."
    return f"{base}{found.summary().splitlines()[0].partition(': ')[2]}."
