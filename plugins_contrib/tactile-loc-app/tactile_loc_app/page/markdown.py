"""Text on the page. Names and messages may come from a visitor's file, so they are shown literally.

The page draws Markdown with raw HTML, so a name could hold a script, a link or a picture. All other texts of the page
(notifications, labels, lists, buttons) are plain text to the browser. Only this module writes Markdown.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from tactile_loc.commands import fold_line

if TYPE_CHECKING:
    from viser import ClientHandle

_LINK_SIGNS = re.compile(r"(?<=\S)(?=[:@.])")  # addresses become links where these signs follow a letter
_BREAK = "<!-- -->"


def list_numbered(names: Iterable[str]) -> list[str]:
    """Return names with their numbers, from 1, as the options of a list."""
    return [f"{number}: {fold_line(name)}" for number, name in enumerate(names, 1)]


def escape(text: object) -> str:
    """Return the Markdown that shows a text literally: no HTML, link, picture, list, table or emphasis."""
    parts = _LINK_SIGNS.split(fold_line(str(text)))
    return _BREAK.join("".join(map(_escape_character, part)) for part in parts)


def _escape_character(letter: str) -> str:
    return letter if letter.isalnum() or letter == " " else f"&#{ord(letter)};"


class Paragraph:
    """A paragraph of the page in Markdown."""

    def __init__(self, client: ClientHandle, template: str = "", visible: bool = True) -> None:
        self._handle = client.gui.add_markdown(template, visible=visible)

    def fill(self, template: str, *values: object, row: str = "", rows: Iterable[Sequence[object]] = ()) -> None:
        """Show a template of the program in Markdown, and `row` for each of `rows`. All values are shown literally."""
        texts = [template.format(*map(escape, values)), *(row.format(*map(escape, one)) for one in rows)]
        self._handle.content = "".join(texts)

    @property
    def visible(self) -> bool:
        """Whether the paragraph is shown."""
        return bool(self._handle.visible)

    @visible.setter
    def visible(self, value: bool) -> None:
        self._handle.visible = value
