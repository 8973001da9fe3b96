"""The messages that docs/troubleshooting.md quotes exist in the code, and its commands and verdicts, too."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from tactile_loc_cli.main import app
from typer.main import get_command

from tactile_loc.locate.result.verdict import MEANINGS, Verdict

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
QUOTED = [q for q in (" ".join(q.split()) for q in re.findall(r'"([^"|]+)"', PAGE)) if q != "…"]


def join(node: ast.JoinedStr) -> str:
    return "".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values)


@cache
def list_texts() -> tuple[str, ...]:
    """All strings of the code, with … for the values in formatted strings."""
    trees = [ast.parse(path.read_text()) for folder in ("tactile_loc", "cli") for path in (ROOT / folder).rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    formatted = [join(node) for node in nodes if isinstance(node, ast.JoinedStr)]
    return (*formatted, *(n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)))


def is_in_code(quote: str) -> bool:
    parts = [part.strip() for part in quote.split("…") if part.strip()]
    pattern = re.compile(".*".join(map(re.escape, parts)), re.DOTALL)
    return any(pattern.search(text) for text in list_texts())


def test_a_message_that_does_not_exist_is_noticed():
    assert not is_in_code("the gel is … made of cheese")
    assert is_in_code("several poses explain the touch; …")


def test_the_page_quotes_many_messages():
    assert len(QUOTED) > 15


@pytest.mark.parametrize("quote", QUOTED)
def test_every_quoted_message_exists(quote):
    assert is_in_code(quote)


def test_every_uncertain_verdict_is_explained():
    rows = re.findall(r'^\| `([\w ]+)` \| "([^"]+)" \|', PAGE, re.MULTILINE)
    assert dict(rows) == {v.value: MEANINGS[v] for v in Verdict if v is not Verdict.CERTAIN}


def test_every_command_exists():
    named = set(re.findall(r"`tactile-loc ([a-z-]+)", PAGE))
    assert named
    assert named <= set(get_command(app).commands)
