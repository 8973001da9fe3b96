"""The package of a new component, made from templates."""

from __future__ import annotations

import os
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.slots.registry import registry
from tactile_loc.store.files import replace_folder
from tactile_loc_cli.scaffold.naming import Naming

# Summary of the component in each slot's template.
SUMMARIES = {
    "sensor": "a rectangular gel, seen from behind, given as depths",
    "renderer": "exact, triangle by triangle",
    "grid": "x, y and yaw of the object, upright as in its mesh",
    "encoder": "the share of each coarse cell that is in contact",
    "matcher": "compares with every row of the bank",
    "refiner": "slides the contact's centre onto the touch's",
    "fuser": "product of the touches' probabilities and the prior",
}
ADVICE_OF_COMPONENTS = (
    "Increase its `version` when the same input gives another output: the store keeps the results of each version."
)
ADVICE = {"command": "`tactile_loc.commands` offers what commands share: options, output, failures and workers."}


def describe_example(slot: str) -> str:
    """Return the summary of the component in a slot's template."""
    kind = registry().kinds[slot]
    return kind.example if kind else SUMMARIES[slot]


def render(naming: Naming) -> dict[str, str]:
    """Return the text of each file of the package. The keys are the files' paths in the package's folder."""
    named = ("slot", "name", "distribution", "package", "class_name", "module", "usage")
    values = {**{name: getattr(naming, name) for name in named}, "summary": describe_example(naming.slot)}
    values["advice"] = ADVICE.get(naming.slot, ADVICE_OF_COMPONENTS)
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"{naming.package}/__init__.py": naming.hook,
        f"{naming.package}/{naming.module}.py": f"{naming.module}.py",
        f"tests/test_{naming.name.replace('-', '_')}.py": f"test_{naming.module}.py",
    }
    kind = registry().kinds[naming.slot]
    own = files(kind.templates if kind else __package__) / "templates"
    return {path: _read_template(template, own).substitute(values) for path, template in templates.items()}


def write(naming: Naming, folder: Path) -> list[str]:
    """Write the package to the new `folder`, completely or not at all, and return its files' paths in the folder.

    Raises OutputError if the folder exists or cannot be written.
    """
    if os.path.lexists(folder):
        raise OutputError(f"{folder} already exists; choose another --out")
    made = render(naming)
    try:
        with replace_folder(folder, fresh=True) as beside:
            for path, text in made.items():
                (beside / path).parent.mkdir(parents=True, exist_ok=True)
                (beside / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{folder} cannot be written ({error.strerror or error}); choose another --out") from error
    return sorted(made)


def _read_template(name: str, own: Traversable) -> Template:
    """Return a template of the folder `own`, or the one that all slots share."""
    file = own / f"{name}.tmpl"
    found = file if file.is_file() else files(__package__) / "templates" / f"{name}.tmpl"
    return Template(found.read_text(encoding="utf-8"))
