"""Read the pages of the documentation, their blocks of code, and the commands in them."""

import itertools
import re
import shlex
from pathlib import Path
from typing import Any

import trimesh
from tactile_loc_cli.main import app
from typer.main import get_command

from tactile_loc import load_object

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def read_page(name: str) -> str:
    """Return the text of a page, given by its path below docs, or of the README."""
    return ((ROOT if name == "README.md" else DOCS) / name).read_text(encoding="utf-8")


def find_blocks(text: str, language: str) -> list[str]:
    """Return the texts of the fenced blocks in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def list_commands(text: str) -> list[list[str]]:
    """Return the words of each line of the shell blocks, without leading environment variables and comments."""
    lines = [shlex.split(line, comments=True) for block in find_blocks(text, "sh") for line in block.splitlines()]
    return [list(itertools.dropwhile(re.compile(r"[A-Z_]+=\S*").fullmatch, words)) for words in lines if words]


def understand(words: list[str]) -> dict[str, Any]:
    """Return the parameters of a `tactile-loc` command, given without the program. An unknown option raises."""
    command: Any = get_command(app)
    while commands := getattr(command, "commands", None):
        if words[0].startswith("-"):  # such as --help, of the group
            return {}
        name, *words = words
        command = commands[name]
    return command.make_context(name, words).params


def write_part(path: Path, name: str = "pin") -> Path:
    """Write the mesh of a demo object, in millimetres, and return its path."""
    mesh = load_object(name).mesh
    trimesh.Trimesh(mesh.vertices_m * 1e3, mesh.faces, process=False).export(path)
    return path
