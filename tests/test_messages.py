"""Messages of the library suit Python and the command line: they name settings, such as `touch_unit`, not flags."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

LIBRARY = Path(__file__).parents[1] / "tactile_loc"
FLAG = re.compile(r"(?<![\w-])--[a-z]")
WHOLE_COMMAND = re.compile(r"(?:tactile-loc [a-z]|pip install).*")  # a command to copy may have flags
OF_LIBRARIES = re.compile(r"--xla_\w+")  # flags that other libraries read from the environment


def list_texts(source: str) -> Iterator[tuple[int, str]]:
    """Yield the string constants of a module, except docstrings, with their lines."""
    tree = ast.parse(source)
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = (node.body for node in ast.walk(tree) if isinstance(node, owners))
    docstrings = {id(body[0].value) for body in bodies if body and isinstance(body[0], ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.lineno, node.value


def find_flags(source: str) -> list[tuple[int, str]]:
    texts = list_texts(source) if "--" in source else ()  # parsing takes long
    return [(line, text) for line, text in texts if FLAG.search(OF_LIBRARIES.sub("", WHOLE_COMMAND.sub("", text)))]


@pytest.mark.parametrize(
    "source", ['raise ValueError("give --units mm")', "def f():\n    text = f'{x}; choose another --out'"]
)
def test_a_flag_in_a_message_is_found(source):
    assert find_flags(source)


@pytest.mark.parametrize("source", ['"""Options such as --units."""', "x = 'run tactile-loc store prune --all'"])
def test_docstrings_and_whole_commands_may_have_flags(source):
    assert not find_flags(source)


def test_no_message_of_the_library_names_a_flag():
    found = {
        str(path.relative_to(LIBRARY)): flags
        for path in LIBRARY.rglob("*.py")
        if (flags := find_flags(path.read_text()))
    }
    assert found == {}
