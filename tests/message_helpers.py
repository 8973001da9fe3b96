"""Find the values that a message must name, whatever its sentence is."""

from __future__ import annotations

import re


def naming(*values: object) -> str:
    """Return a pattern for texts that hold all values, in any order; a number is not found within a longer one."""
    return r"(?s)\A" + "".join(f"(?=.*{_alone(str(value))})" for value in values)


def missing(text: str, *values: object) -> list[str]:
    """Return those of the values that a text does not hold."""
    return [str(value) for value in values if not re.search(_alone(str(value)), text)]


def _alone(value: str) -> str:
    before = r"(?<![\d.])" if value[:1].isdigit() else ""
    after = r"(?!\.?\d)" if value[-1:].isdigit() else ""
    return before + re.escape(value) + after
