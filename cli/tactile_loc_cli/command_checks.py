"""Contract checks for commands. They import a command's target, and read the declarations of its options."""

import inspect
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from typing import Any, get_type_hints

from tactile_loc.slots.registry import CommandSpec, Offer, import_target
from tactile_loc.testing.contract import check, require

SHARED = {"--json", "-v", "--verbose", "-q", "--quiet", "-h", "--help"}  # tactile-loc adds these to every command
HEAVY = ("faiss", "matplotlib", "numba", "open3d", "scipy", "torch", "trimesh")
PROBE = "import sys, {module}; print(*[name for name in {heavy!r} if name in sys.modules])"


@check("command")
def check_target(spec: CommandSpec) -> None:
    """The target is a function, or a typer application with commands."""
    functions = list_functions(spec)
    require(functions, f"the application {spec.target} must have commands: functions with @application.command()")


@check("command")
def check_summary(spec: CommandSpec) -> None:
    """The summary is one sentence, as in the list of commands."""
    good = spec.summary[:1].isupper() and spec.summary.endswith(".") and "\n" not in spec.summary
    require(good, f"the summary must be one sentence with a capital and a full stop, not {spec.summary!r}")


@check("command")
def check_help(spec: CommandSpec) -> None:
    """Every function has a docstring, which is its help; that of a single command begins with the summary."""
    for name, function in list_functions(spec).items():
        about = inspect.getdoc(function) or ""
        require(about, f"the command {name} needs a docstring, which is its help")
        if name == spec.name:
            first = about.partition("\n")[0]
            require(first == spec.summary, f"the docstring must begin with the summary {spec.summary!r}, not {first!r}")


@check("command")
def check_options_are_described(spec: CommandSpec) -> None:
    """Every option and argument has a help text."""
    for name, function in list_functions(spec).items():
        for parameter, declared in _list_declared(function):
            require(
                declared is not None and declared.help,
                f"every option needs Annotated[..., declare(...)] with a help text; {parameter} of {name} has none",
            )


@check("command")
def check_shared_options(spec: CommandSpec) -> None:
    """No option takes a name of the options that tactile-loc adds to every command."""
    for name, function in list_functions(spec).items():
        for _, declared in _list_declared(function):
            # typer takes the first flag as a default
            flags = (getattr(declared, "default", None), *(getattr(declared, "param_decls", None) or ()))
            taken = SHARED & {flag for flag in flags if isinstance(flag, str)}
            require(not taken, f"{name} must not declare {', '.join(sorted(taken))}; every command has it already")


@check("command")
def check_import_is_light(spec: CommandSpec) -> None:
    """The module of the target imports no heavy library, so that help and completion are instant."""
    probe = PROBE.format(module=spec.target.partition(":")[0], heavy=HEAVY)
    found = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False).stdout.split()
    require(not found, f"the module must not import {', '.join(found)}; import it in the function that uses it")


def list_functions(spec: CommandSpec) -> dict[str, Callable[..., Any]]:
    """Return the functions of a command by name; several if its target is a typer application."""
    target = import_target(Offer(spec, "this package"))
    if inspect.isfunction(target):
        return {spec.name: target}
    named = ((info.name, info.callback) for info in target.registered_commands)
    return {f"{spec.name} {name or function.__name__.replace('_', '-')}": function for name, function in named}


def _list_declared(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Yield the name and typer's declaration of each option, None if it has none.

    The options are the parameters, and the fields of a dataclass that is a parameter. A parameter that stands for
    shared options has a declaration of another kind, and is left out.
    """
    from typer.models import ParameterInfo

    hints = {name: one.annotation for name, one in inspect.signature(function, eval_str=True).parameters.items()}
    for name, kind in list(hints.items()):
        if is_dataclass(kind):
            del hints[name]
            hints |= get_type_hints(kind, include_extras=True)
    for name, hint in hints.items():
        extras = getattr(hint, "__metadata__", ())
        if not extras or any(isinstance(extra, ParameterInfo) for extra in extras):
            yield name, next((extra for extra in extras if isinstance(extra, ParameterInfo)), None)
