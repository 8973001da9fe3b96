"""Messages of the library suit Python and the command line: they name settings, such as `touch_unit`, not flags."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from tactile_loc_cli.main import app

LIBRARY = Path(__file__).parents[1] / "tactile_loc"
COMMANDS = Path(__file__).parents[1] / "cli" / "tactile_loc_cli"
FLAG = re.compile(r"(?<![\w-])--[a-z]")
FLAGS = re.compile(r"(?<![\w-])--[a-z][\w-]*")
WHOLE_COMMAND = re.compile(r"(?:tactile-loc [a-z]|pip install).*")  # a command to copy may have flags
OF_LIBRARIES = re.compile(r"--xla_\w+")  # flags that other libraries read from the environment


def list_texts(source: str) -> Iterator[tuple[int, str]]:
    """Yield the strings of a module, except docstrings, with their lines. Values in f-strings become "{}"."""
    tree = ast.parse(source)
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = (node.body for node in ast.walk(tree) if isinstance(node, owners))
    docstrings = {id(body[0].value) for body in bodies if body and isinstance(body[0], ast.Expr)}
    formatted = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    parts = {id(part) for node in formatted for part in node.values}
    for node in formatted:
        yield node.lineno, "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings | parts:
            yield node.lineno, node.value


def find_flags(source: str) -> list[tuple[int, str]]:
    texts = list_texts(source) if "--" in source else ()  # parsing takes long
    return [(line, text) for line, text in texts if FLAG.search(OF_LIBRARIES.sub("", WHOLE_COMMAND.sub("", text)))]


@pytest.mark.parametrize(
    "source", ['raise ValueError("give --units mm")', "def f():\n    text = f'{x}; choose another --out'"]
)
def test_a_flag_in_a_message_is_found(source):
    assert find_flags(source)


def test_no_message_of_the_library_names_a_flag():
    found = {
        str(path.relative_to(LIBRARY)): flags
        for path in LIBRARY.rglob("*.py")
        if path.parent.name != "testing"  # contract checks name the flags that they require
        and (flags := find_flags(path.read_text()))
    }
    assert found == {}


def list_options(command: Any) -> set[str]:
    """Return the flags of a command, or of all commands of a group."""
    others = [list_options(one) for one in getattr(command, "commands", {}).values()]
    return set().union(*others, *(one.opts + one.secondary_opts for one in command.params))


def test_messages_of_a_command_name_only_its_own_options():
    commands = typer.main.get_command(app).commands
    modules = [path for name in ("commands", "evaluate") for path in (COMMANDS / name).glob("*.py")]
    owners = {path: path.stem.replace("_", "-") for path in modules}
    owners |= {path: "evaluate" for path in modules if path.parent.name == "evaluate" and path.stem != "paper"}
    known = {path: list_options(commands[name]) for path, name in owners.items() if name in commands}
    known[COMMANDS / "commands" / "plugins.py"] |= list_options(commands["new-plugin"])
    assert len(known) > 15
    for path, options in known.items():
        texts = [WHOLE_COMMAND.sub("", text) for _, text in list_texts(path.read_text())]
        assert {flag for text in texts for flag in FLAGS.findall(text)} <= {*options, "--help"}, path
