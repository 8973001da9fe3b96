"""Pieces of HTML. Whatever comes from a file or a user goes through `escape`."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

LONG = 20  # characters of a main number that needs more room


def escape(text: object) -> str:
    """Return text that is shown as it is, also within an attribute."""
    return html.escape(str(text), quote=True)


def script_json(value: Any) -> str:
    """Return JSON that may stand in a script element: nothing in it ends the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def tiles(values: Iterable[tuple[str, str, str]]) -> str:
    """Return the main numbers: (name, value, what it means) each; a long value gets more room."""
    cells = [
        f'<div class="{"tile wide" if len(value) > LONG else "tile"}">'
        f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd><p>{escape(meaning)}</p></div>"
        for name, value, meaning in values
    ]
    return f'<dl class="tiles">{"".join(cells)}</dl>'


def table(header: Sequence[str], rows: Iterable[Sequence[object]], left: int = 1, label: str = "") -> str:
    """Return a table, the first `left` columns to the left, the others to the right."""
    head = "".join(f'<th scope="col"{_side(i, left)}>{escape(name)}</th>' for i, name in enumerate(header))
    body = "".join(
        "<tr>" + "".join(f"<td{_side(i, left)}>{escape(cell)}</td>" for i, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    named = f' aria-label="{escape(label)}"' if label else ""
    return f'<div class="scroll"><table{named}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def details(summary: str, body: str) -> str:
    """Return what can be opened; `body` is HTML."""
    return f"<details><summary>{escape(summary)}</summary>{body}</details>"


def preformatted(text: str) -> str:
    """Return text in a fixed font."""
    return f"<pre>{escape(text)}</pre>"


def figure(name: str, caption: str, extra: str = "", size: str = "") -> str:
    """Return the place for a plot that scripts draw, with a caption.

    `extra` is HTML above it: the plot's choices. `size` is a class of the style sheet: "tall3d", "short", or none.
    """
    return (
        f'<figure class="plot">{extra}<div class="plotly {escape(size)}" id="{escape(name)}"></div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def choice(name: str, label: str, options: Mapping[str, str] | Sequence[str], chosen: str | None = None) -> str:
    """Return a list to choose from: values and what is shown, or both in one."""
    pairs = options.items() if isinstance(options, Mapping) else ((value, value) for value in options)
    items = "".join(
        f'<option value="{escape(value)}"{" selected" if value == chosen else ""}>{escape(shown)}</option>'
        for value, shown in pairs
    )
    return f'<label class="choice">{escape(label)} <select id="{escape(name)}">{items}</select></label>'


def versions_table(versions: Mapping[str, str]) -> str:
    """Return the versions of what a result was made with."""
    return table(["package", "version"], list(versions.items()), left=2, label="versions")


def _side(column: int, left: int) -> str:
    return ' class="left"' if column < left else ""
