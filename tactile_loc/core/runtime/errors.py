"""All errors that a user can meet. A message states what is wrong, where, and what to do, in one or two sentences."""

import difflib
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from tactile_loc.core.runtime.formatting import show_name

MOST_LETTERS = 1500  # largest length of a message
_source: ContextVar[str] = ContextVar("source", default="")


class TactileLocError(Exception):
    """Base class for all errors raised on purpose. The command line prints the message and exits with code 2.

    The message is one line of at most MOST_LETTERS characters, without control characters.
    """

    def __str__(self) -> str:
        return fold_line(super().__str__())


class ObjectError(TactileLocError):
    """The object cannot be used: its file is missing, not a mesh, empty, not finite, or of an impossible size."""


class SymmetryError(ObjectError):
    """A declared symmetry cannot be read, or the object's surface contradicts it."""


class SensorError(TactileLocError):
    """A sensor description is incomplete or contradicts itself."""


class TouchError(TactileLocError):
    """A touch cannot be used: its size, type or unit is wrong, or no pixel or every pixel is in contact."""


class NoContactError(TouchError):
    """Nothing touches the sensor: the image or the contact shape shows the gel at rest."""


class RecordingError(TactileLocError):
    """A recording cannot be used: it is missing, not a recording, without the topic, or has unreadable messages."""


class SourceError(TactileLocError):
    """A camera, a folder or a video gives no images: it does not exist, or it has disappeared."""


class FrameError(TactileLocError):
    """The transform between two frames at some time is unknown."""


class CalibrationError(TactileLocError):
    """A sensor cannot be calibrated from these presses, or a calibration cannot be used."""


class MountError(TactileLocError):
    """A sensor's mount cannot be found, because the touches are too few, too similar, or contradict each other."""


class GridError(TactileLocError):
    """The object, the sensor and the options give no usable pose grid."""


class RenderError(TactileLocError):
    """A renderer cannot run here, for instance without EGL."""


class ConfigError(TactileLocError):
    """A configuration or option is unknown or has a wrong type."""


class OutputError(TactileLocError):
    """Results cannot be written to the chosen place."""


class ResultError(TactileLocError):
    """A result cannot be shown: its file is missing, damaged, or written by another version."""


class StoreError(TactileLocError):
    """The stage store cannot be read or written, for instance because the disk is full."""


class TrainingError(TactileLocError):
    """A training failed: its loss is no longer a number."""


class WeightsError(TactileLocError):
    """Weights of a network cannot be used: they are missing, damaged, or of another architecture."""


class PluginError(TactileLocError):
    """A plugin cannot be used."""


class UnknownPluginError(PluginError):
    """No plugin with this name fills the slot."""


class PluginLoadError(PluginError):
    """A plugin raised an error while it was imported or registered."""


class PluginConflictError(PluginError):
    """Two distributions offer a component with the same slot and name."""


class MissingLibraryError(PluginError):
    """A plugin needs a library that is not installed."""


def fold_line(text: str) -> str:
    """Return a text as one line. Unprintable characters are escaped, and a very long text loses its middle."""
    words = " ".join(text.split())
    shown = show_name(words)
    half = MOST_LETTERS // 2
    return shown if len(shown) <= MOST_LETTERS else f"{shown[:half]} ... {shown[3 - half :]}"


def quote(value: Any) -> str:
    """Return a value's representation, shortened if it is long."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 200
    short.maxlist = short.maxdict = short.maxtuple = 8
    return short.repr(value)


@contextmanager
def name_source(source: object) -> Iterator[None]:
    """Add `source`, such as a file, at the start of errors from the block, unless they mention it already.

    `mention_source` adds it to warnings.
    """
    try:
        with note_source(source):
            yield
    except TactileLocError as error:
        if fold_line(str(source)) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error


@contextmanager
def note_source(source: object) -> Iterator[None]:
    """Let `mention_source` add `source` to warnings of the block. Errors stay as they are."""
    before = _source.set(str(source))
    try:
        yield
    finally:
        _source.reset(before)


def mention_source(warning: str) -> str:
    """Return a warning with the source that the program reads, unless the warning begins with it already."""
    source = _source.get()
    return f"{source}: {warning}" if source and not warning.startswith(source) else warning


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " Did you mean 'x'?" for the nearest known names, or "" if none is near."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.65)  # one wrong letter in three
    near += [other for other in names if sorted(other.split("_")) == sorted(name.split("_")) and other not in near]
    return f" Did you mean {' or '.join(repr(n) for n in near[:3])}?" if near else ""


def advise_choice(name: str, known: Iterable[str]) -> str:
    """Return "choose a, b or c" for the known names, and "Did you mean 'b'?" if `name` is near some of them."""
    names = list(known)
    if not names:
        return "there are none"
    *others, last = names
    listed = f"{', '.join(others)} or {last}" if others else last
    near = did_you_mean(name, names)
    return f"choose {listed}" + (f".{near}" if near else "")
