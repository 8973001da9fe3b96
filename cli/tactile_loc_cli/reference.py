"""Writes docs/cli.md from the help texts and the schema of result.json: `python -m tactile_loc_cli.reference`."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

WIDTH = "100"

INTRODUCTION = """\
# The command line

This page is generated: `python -m tactile_loc_cli.reference` writes it, and a test compares it with the program.

`tactile-loc run` without any options locates a demo object from a simulated touch. What people read is in mm and
degrees; files are in SI units. Errors are one line on stderr.

| exit code | meaning |
|---|---|
| 0 | done; `live`, when Ctrl-C ends it, too |
| 1 | done, but a part of `sweep` failed, a contract is broken, `doctor` found a fault, `identify` no object; or a bug |
| 2 | the input, an option, a component or a place to write cannot be used; the line says which, and what to do |
| 130 | interrupted with Ctrl-C; what was finished is kept, and the same command resumes |

Every command takes three more options, and the program itself the last two, before the command:

- `--json` writes the result to stdout as one JSON document, in SI units, and nothing else. When the command fails, the
  document is `{"error": {"kind": "TouchError", "message": "..."}}`, beside the line on stderr and the same exit code.
- `-v` says on stderr what is being done, a line each, with the seconds since the start. `-vv` gives all details, and
  the traceback of an error.
- `-q` hides warnings and progress bars.

## Completion

`tactile-loc --install-completion` teaches the shell that runs it (bash, zsh or fish) to complete commands, options, the
names of components, demo objects and slots; `--show-completion` prints the script instead. Start a new shell after it.
Paths are completed once a letter is typed that begins no name.

## Configuration files

`--config run.toml` takes every setting from a file; options on the command line override it. All entries are optional,
unknown ones are refused. Paths are relative to where the command runs.

```toml
top = 10               # how many poses to list
seed = 0
shape_px = 64          # the longer image side of the grid's contact shapes, pixels
# coverage = 0.95       # list all modes of a set that holds the true pose with this probability
# drop_outliers = true # of several touches leave out those that contradict the others
# temperature = 1e-3   # of the softmax over scores; by default fitted to simulated touches
# drawing = "paper"    # compare with the object where it just touches; by default "pressed", as the sensor sees it

[object]
path = "hook"          # a mesh file or a demo object
units = "auto"         # m, mm, cm, inch
symmetry = "auto"

[touch]
# path = "touch.npz"   # without it, a touch is simulated
# unit = "mm"          # m, mm, um; when the file does not say
# press_depth_mm = 1.5
# noise = "mild"       # none, mild, strong; of a simulated touch

[sensor]               # a slot: the component's name, and its options beside it
name = "gelslim"

[grid]
name = "face"
spacing_mm = 3.0
```

The slots are `sensor`, `renderer`, `grid`, `encoder`, `matcher`, `refiner` and `fuser`. `tactile-loc plugins` lists
what can fill them, `tactile-loc plugins grid face` the options of one.
"""


def make_reference() -> str:
    """Return the text of docs/cli.md."""
    return "\n".join([INTRODUCTION, *_list_helps(), *_describe_schema()])


def _list_helps() -> Iterator[str]:
    yield "## Commands\n"
    yield _show_help([])
    for words in _list_commands():
        yield f"### {' '.join(words)}\n"
        yield _show_help(words)


def _list_commands() -> Iterator[list[str]]:
    """The words of every command, those of a group after it."""
    from typer.main import get_command

    from tactile_loc_cli.main import app

    for name, command in getattr(get_command(app), "commands", {}).items():
        yield [name]
        yield from ([name, one] for one in getattr(command, "commands", {}))


def _show_help(arguments: list[str]) -> str:
    from typer.testing import CliRunner

    from tactile_loc_cli.main import app

    shown = CliRunner().invoke(app, [*arguments, "--help"], prog_name="tactile-loc", env={"COLUMNS": WIDTH})
    return f"```text\n{shown.stdout.rstrip()}\n```\n"


def _describe_schema() -> Iterator[str]:
    from tactile_loc.locate.results import result_json as results

    yield (
        "## result.json\n\nEverything that a run found, and everything it was made from. Lengths in metres, times in "
        "seconds; transforms are\n4 x 4 matrices `T_target_source`, row by row. The answer is "
        "`hypotheses[0].T_sensor_object`.\n"
    )
    for key, model in (
        ("", results.ResultRecord), ("object", results.ObjectRecord), ("touch", results.TouchRecord),
        ("hypotheses[]", results.HypothesisRecord), ("errors", results.ErrorRecord),
    ):  # fmt: skip
        if key:
            yield f"### {key}\n\n{model.__doc__}\n"
        yield _describe_record(model)


def _describe_record(model: type[BaseModel]) -> str:
    rows = [
        f"| `{name}` | {_name_type(field.annotation)} | {field.description} |"
        for name, field in model.model_fields.items()
    ]
    return "\n".join(["| key | type | meaning |", "|---|---|---|", *rows, ""])


def _name_type(annotation: Any) -> str:
    """Name a type as JSON would."""
    arms = get_args(annotation)
    if type(None) in arms:
        return f"{_name_type(next(a for a in arms if a is not type(None)))} or null"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "object"
    if isinstance(annotation, type) and issubclass(annotation, StrEnum):
        return "text"
    text = str(annotation)
    if text.count("list[") > 1:
        return "rows of numbers"
    names = {int: "integer", float: "number", str: "text", bool: "true or false"}
    return "list" if text.startswith("list") else "object" if text.startswith("dict") else names[annotation]


def main() -> None:
    """Write docs/cli.md of the source tree that this module lies in."""
    page = Path(__file__).parents[2] / "docs" / "cli.md"
    page.write_text(make_reference(), encoding="utf-8")


if __name__ == "__main__":
    main()
