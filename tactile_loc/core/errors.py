"""Every error a user can meet. One sentence each: what is wrong, where, and what to do about it."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from tactile_loc.core.deprecation import make_getattr

MOST_LETTERS = 1500  # of a sentence


class TactileLocError(Exception):
    """Base of all errors raised on purpose. The command line prints it as one sentence and exits with code 2.

    Whatever it quotes of a file, it is one line of bounded length without control characters.
    """

    def __str__(self) -> str:
        return fold_line(super().__str__())


class ObjectError(TactileLocError):
    """The object cannot be used: file missing, not a mesh, empty, non-finite, or of an impossible size."""


class SymmetryError(ObjectError):
    """A declared symmetry cannot be read, or the object's surface contradicts it."""


class SensorError(TactileLocError):
    """A sensor description is incomplete or contradicts itself."""


class TouchError(TactileLocError):
    """A touch cannot be used: wrong size, type or unit, no contact, or nothing but contact."""


class NoContactError(TouchError):
    """Nothing touches the sensor: an image or a contact shape of the gel at rest."""


class RecordingError(TactileLocError):
    """A recording cannot be used: missing, no recording, without the topic, or of messages that nobody can read."""


class SourceError(TactileLocError):
    """Images cannot be had from a camera, a folder or a video: there is no such source, or it went away."""


class FrameError(TactileLocError):
    """Where one frame is seen from another at some time is not known."""


class CalibrationError(TactileLocError):
    """A sensor cannot be calibrated from these presses, or a calibration cannot be used."""


class MountError(TactileLocError):
    """Where a sensor is mounted cannot be told from these touches: too few, too much alike, or contradictory."""


class GridError(TactileLocError):
    """No usable pose grid comes out of the object, the sensor and the options."""


class RenderError(TactileLocError):
    """A renderer cannot run here, for instance without EGL."""


class ConfigError(TactileLocError):
    """A configuration or option is unknown or ill-typed."""


class OutputError(TactileLocError):
    """Results cannot be written where they were asked to go."""


class ResultError(TactileLocError):
    """A result cannot be shown: no such file, damaged, or written by another version."""


class StoreError(TactileLocError):
    """The stage store cannot be read or written, for instance because the disk is full."""


class TrainingError(TactileLocError):
    """A training went wrong: its loss is no longer a number."""


class WeightsError(TactileLocError):
    """Weights of a network cannot be used: out of reach, damaged, or of another architecture."""


class PluginError(TactileLocError):
    """A plugin cannot be used."""


class UnknownPluginError(PluginError):
    """No plugin of this name fills the slot."""


class PluginLoadError(PluginError):
    """A plugin raised while being imported or registered."""


class PluginConflictError(PluginError):
    """Two distributions offer a component of the same slot and name."""


class MissingLibraryError(PluginError):
    """A plugin needs a library that is not installed."""


def fold_line(text: str) -> str:
    """Return a text as one line; what cannot be printed is escaped, and of a very long one the middle is left out."""
    words = " ".join(text.split())
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in words)
    half = MOST_LETTERS // 2
    return shown if len(shown) <= MOST_LETTERS else f"{shown[:half]} ... {shown[3 - half :]}"


def quote(value: Any) -> str:
    """Return a value as Python writes it, long ones abridged."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 200
    short.maxlist = short.maxdict = short.maxtuple = 8
    return short.repr(value)


@contextmanager
def name_source(source: object) -> Iterator[None]:
    """Have errors of the block begin with `source`, a file say, unless they mention it."""
    try:
        yield
    except TactileLocError as error:
        if str(source) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " Did you mean 'x'?" for the nearest known names, or an empty string when none is near."""
    near = difflib.get_close_matches(name, sorted(known), n=3, cutoff=0.5)
    return f" Did you mean {' or '.join(repr(n) for n in near)}?" if near else ""


__getattr__ = make_getattr(__name__)
