"""The error of the page."""

from tactile_loc import TactileLocError


class AppError(TactileLocError):
    """A visitor's file or wish cannot be used. The message states what is wrong and what to do."""
