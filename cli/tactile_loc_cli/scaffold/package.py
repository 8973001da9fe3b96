"""A new component's package, made from templates and written whole or not at all."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from string import Template

from tactile_loc.core.errors import OutputError
from tactile_loc.store.files import replace_folder
from tactile_loc_cli.scaffold.naming import Naming

# What the template of each slot does until somebody replaces it.
SUMMARIES = {
    "sensor": "a gel that is seen straight on, given as depths",
    "renderer": "exact, triangle by triangle",
    "grid": "x, y and yaw of the object as it is modelled",
    "encoder": "the share of each coarse cell that is in contact",
    "matcher": "compares with every row of the bank",
    "refiner": "slides the contact's centre onto the touch's",
    "fuser": "product of the touches' probabilities and the prior",
}


def render(naming: Naming) -> dict[str, str]:
    """Return the package's files: their paths in its folder, and their text."""
    values = {
        "slot": naming.slot,
        "name": naming.name,
        "distribution": naming.distribution,
        "package": naming.package,
        "class_name": naming.class_name,
        "summary": SUMMARIES[naming.slot],
    }
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"{naming.package}/__init__.py": "hook.py",
        f"{naming.package}/{naming.slot}.py": f"{naming.slot}.py",
        f"tests/test_{naming.name.replace('-', '_')}.py": f"test_{naming.slot}.py",
    }
    return {path: _template(template).substitute(values) for path, template in templates.items()}


def write(naming: Naming, folder: Path) -> list[str]:
    """Write the package to `folder`, which must not exist, and return the paths of its files in it.

    It is written beside it and then renamed, so that nothing half-written is left. Raises OutputError when the folder
    exists or cannot be written.
    """
    if os.path.lexists(folder):
        raise OutputError(f"{folder} exists already and is left as it is; choose another folder with --out")
    made = render(naming)
    try:
        with replace_folder(folder, fresh=True) as beside:
            for path, text in made.items():
                (beside / path).parent.mkdir(parents=True, exist_ok=True)
                (beside / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{folder} cannot be written ({error.strerror or error}); choose another --out") from error
    return sorted(made)


def _template(name: str) -> Template:
    return Template((files("tactile_loc_cli.scaffold") / "templates" / f"{name}.tmpl").read_text(encoding="utf-8"))
