"""The sensor in place of the 3D view, while the tab of the calibration is open."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from tactile_loc import Palette
from tactile_loc.commands import make_png_url

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from viser import ClientHandle

PALETTE = Palette()
DPI = 200
DRAWING = "\n".join(
    [
        '<svg viewBox="0 0 460 300" width="620" font-family="sans-serif" font-size="15" fill="{ink}">',
        '<path d="M110 210h240v32H110z" fill="{gel}" stroke="{ink}"/>',
        '<path d="M95 242h270l-40 52H135z" fill="{housing}"/>',
        '<path d="M230 120a52 52 0 0 1 0 104a52 52 0 0 1 0-104" fill="{best}" stroke="{ink}"/>',
        '<path d="M197 210q33 30 66 0" fill="none" stroke="{truth}" stroke-width="3"/>',
        '<path d="M230 20v66m-8-13 8 15 8-15" fill="none" stroke="{ink}" stroke-width="2.5"/>',
        '<path d="M300 120v52m-6-46 6-7 6 7m-12 40 6 7 6-7M230 172h78" fill="none" stroke="{soft}"/>',
        '<text x="312" y="151">ball radius</text><text x="30" y="231">gel</text><text x="30" y="272" >sensor</text>',
        '<text x="245" y="48">press, and take a photo</text></svg>',
    ]
)


class SensorCover:
    """Covers the view with a drawing of how to press, and then with what the calibrated sensor reads."""

    def __init__(self, client: ClientHandle) -> None:
        colours = {name: getattr(PALETTE, name) for name in ("ink", "soft", "gel", "housing", "best", "truth")}
        self._handle = client.gui.add_html(self._cover(DRAWING.format(**colours)))

    def show(self, figure: Figure) -> None:
        """Show a figure."""
        file = io.BytesIO()
        figure.savefig(file, dpi=DPI, format="png")
        self._handle.content = self._cover(f'<img alt="a reading" src="{make_png_url(file.getvalue())}">')

    @staticmethod
    def _cover(inside: str) -> str:
        return f'<div class="cover">{inside}</div>'
