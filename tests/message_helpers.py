"""Check that a message names certain values, independent of its wording."""

import re


def naming(*values: object) -> str:
    """Return a pattern for texts that contain all values in any order; a number does not match inside a longer one."""
    return r"(?s)\A" + "".join(f"(?=.*{_alone(str(value))})" for value in values)


def missing(text: str, *values: object) -> list[str]:
    """Return the values that a text does not contain."""
    return [str(value) for value in values if not re.search(_alone(str(value)), text)]


def _alone(value: str) -> str:
    before = r"(?<![\d.])" if value[:1].isdigit() else ""
    after = r"(?!\.?\d)" if value[-1:].isdigit() else ""
    return before + re.escape(value) + after
