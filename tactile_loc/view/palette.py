"""The colours that pictures, reports and the interactive page share. Each colour has one meaning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.io.shape_pictures import OUTLINE, read_colour
from tactile_loc.locate.result.result_html import VERDICT_COLOURS
from tactile_loc.locate.result.verdict import Verdict


@dataclass(frozen=True)
class Palette:
    """Colours on light or dark paper, such as "#ffffff". Blue and orange differ for colour-blind readers, too.

    `paper`, `ink`, `soft` and `line` are those of the page, its text, its less important text and its lines. `best` is
    an estimated pose, `truth` the true pose, `contact` an observed outline, `next` the suggested next touch, and
    `expected` the pose of a prior.
    """

    paper: str = "#ffffff"
    ink: str = "#16202c"
    soft: str = "#4b5a68"
    line: str = "#c9d1da"
    best: str = "#80a3cc"
    truth: str = "#e8590c"
    contact: str = OUTLINE
    next: str = "#00795a"
    expected: str = "#d6aa28"
    gel: str = "#c9e4d6"
    housing: str = "#575c66"

    @staticmethod
    def find_verdict(verdict: Verdict | str) -> str:
        """Return the colour of a verdict, dark enough below white text."""
        return VERDICT_COLOURS[Verdict(verdict)]

    @staticmethod
    def rgb(colour: str) -> Floats:
        """Return red, green and blue (3,), 0 to 1, of a colour such as "#ffffff"."""
        return np.array(read_colour(colour), float) / 255


LIGHT = Palette()
DARK = Palette(paper="#1e2129", ink="#e6ebf1", soft="#a8b4c2", line="#4a5563")
