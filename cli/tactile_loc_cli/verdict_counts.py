"""The verdicts of many frames or touches on the terminal: their numbers, and a warning if none is certain."""

from __future__ import annotations

import logging
from collections.abc import Mapping

logger = logging.getLogger(__name__)

WORDS = {
    "certain": "certain", "ambiguous": "ambiguous", "poor_fit": "poor fit", "not_found": "not found",
    "no_contact": "without contact", "refused": "refused",
}  # fmt: skip


def list_verdicts(counts: Mapping[str, int]) -> str:
    """Return the number of frames with each verdict, from `count_frames`, as text."""
    return ", ".join(f"{counts[name]} {word}" for name, word in WORDS.items() if counts[name]) or "none"


def warn_of_uncertain(counts: Mapping[str, int]) -> None:
    """Warn if frames have a pose, but no frame is certain."""
    if counts["located"] and not counts["certain"]:
        logger.warning("no pose is certain; check the object, the sensor and the unit")
