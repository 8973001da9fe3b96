"""The verdicts of many frames on the terminal: their numbers, and a warning if no frame is certain."""

from __future__ import annotations

import logging
from typing import Protocol

logger = logging.getLogger(__name__)


class VerdictCounts(Protocol):
    """The number of frames with each verdict, such as a LiveSummary or a ReplaySummary."""

    @property
    def located(self) -> int:
        """Frames with a pose."""

    @property
    def certain(self) -> int:
        """Frames whose first pose is certain."""

    @property
    def ambiguous(self) -> int:
        """Frames that several poses explain."""

    @property
    def poor_fit(self) -> int:
        """Frames that the first pose does not explain."""

    @property
    def not_found(self) -> int:
        """Frames for which the search found no pose."""

    @property
    def no_contact(self) -> int:
        """Frames without contact."""

    @property
    def refused(self) -> int:
        """Frames that cannot be read."""


def list_verdicts(counts: VerdictCounts) -> str:
    """Return the number of frames with each verdict as text."""
    return (
        f"{counts.certain} certain, {counts.ambiguous} ambiguous, {counts.poor_fit} poor fit, "
        f"{counts.not_found} not found, {counts.no_contact} without contact, {counts.refused} refused"
    )


def warn_of_uncertain(counts: VerdictCounts) -> None:
    """Warn if frames have a pose, but no frame is certain."""
    if counts.located and not counts.certain:
        logger.warning("no pose is certain; check the object, the sensor and the unit")
