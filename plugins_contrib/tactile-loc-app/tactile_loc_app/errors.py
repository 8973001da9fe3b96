"""The error of the page."""

from __future__ import annotations

from tactile_loc import TactileLocError


class AppError(TactileLocError):
    """A visitor's file or wish cannot be used. The message states what is wrong and what to do."""
