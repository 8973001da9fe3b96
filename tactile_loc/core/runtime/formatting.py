"""Formatting for people: SI values as millimetres, percentages, bytes and seconds, and names as printable text."""

import re
import unicodedata

_SURROGATE = re.compile("[\ud800-\udfff]")


def show_name(name: object) -> str:
    r"""Return a name, such as a file's, as printable Unicode text in one line.

    Line breaks and other control characters become escapes such as `\n`. A byte that is not UTF-8, which Python stores
    as a lone surrogate, becomes an escape such as `\xe4`.
    """
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else _escape(c) for c in str(name))


def show_bytes(text: str) -> str:
    r"""Return a text in which each byte that is not UTF-8, a lone surrogate, is an escape such as `\xe4`."""
    return _SURROGATE.sub(lambda found: _escape(found[0]), text)


def is_unicode(name: object) -> bool:
    """Return whether a name can be written as Unicode: it has no lone surrogate."""
    return _SURROGATE.search(str(name)) is None


def _escape(character: str) -> str:
    byte = ord(character) - 0xDC00
    return f"\\x{byte:02x}" if 0x80 <= byte <= 0xFF else character.encode("unicode_escape").decode()


def format_mm(length_m: float) -> str:
    """Return a length, metres, as text in millimetres with up to three digits, without the unit: 0.021, 1.94, 48.2."""
    value = 1e3 * length_m
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def format_millimetres(length_m: float) -> str:
    """Return a length, metres, as text in millimetres with up to two digits and the unit: 0.02 mm, 1.9 mm, 48 mm."""
    value = 1e3 * length_m
    return f"{value:.2f} mm" if value < 1 else f"{value:.1f} mm" if value < 10 else f"{value:.0f} mm"


def format_percent(share: float) -> str:
    """Return a share, 0 to 1, as a percentage: 99.7 %, 61 %, 2.8 %, < 0.1 %."""
    value = 100 * share
    return "< 0.1 %" if value < 0.1 else f"{value:.1f} %" if value < 10 or 99 < value < 99.95 else f"{value:.0f} %"


def format_bytes(nbytes: int) -> str:
    """Return a number of bytes as text: 3 B, 12.3 kB, 4.56 GB."""
    for unit, size_b in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if nbytes >= size_b:
            return f"{nbytes / size_b:.3g} {unit}"
    return f"{nbytes} B"


def format_duration(seconds: float) -> str:
    """Return a duration, seconds, as text: 12.3 ms, 4.5 s."""
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1e3 * seconds:.1f} ms"
