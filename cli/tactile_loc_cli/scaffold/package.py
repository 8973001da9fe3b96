"""The package of a new component or command, made from templates: its names, its files, and their text."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path
from string import Template

from tactile_loc.core.runtime.errors import ConfigError, OutputError, PluginConflictError
from tactile_loc.slots.registry import COMMAND, KEBAB_CASE, registry
from tactile_loc.store.files import replace_folder
from tactile_loc_cli.options import require_slot

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
    "After each change of the code, results are computed anew: a hash of the code is part of the store's keys."
)
ADVICE = {"command": "`tactile_loc.commands` offers what commands share: options, output, failures and workers."}
LONGEST = 30  # characters; lines of the templates stay short with such a name


@dataclass(frozen=True)
class Naming:
    """A new component's slot, and its name in kebab case.

    Raises UnknownPluginError for an unknown slot, and ConfigError if the name is too long or not in kebab case.
    """

    slot: str
    name: str

    def __post_init__(self) -> None:
        require_slot(self.slot)
        if not KEBAB_CASE.fullmatch(self.name) or len(self.name) > LONGEST:
            kind = COMMAND if self.slot == COMMAND else "component"
            raise ConfigError(
                f"a {kind} cannot be called {self.name!r}; use at most {LONGEST} lower-case letters and digits, "
                f"words joined by hyphens, such as my-{self.slot}"
            )

    @property
    def distribution(self) -> str:
        """The package's name for pip and the default folder, such as tactile-loc-my-refiner."""
        return f"tactile-loc-{self.name}"

    @property
    def package(self) -> str:
        """The package's name for imports, such as tactile_loc_my_refiner."""
        return self.distribution.replace("-", "_")

    @property
    def class_name(self) -> str:
        """The name of the class or of the function: MyRefiner for my-refiner, SplineRefiner for spline."""
        if self.slot == COMMAND:
            return "measure_object"  # the function of the template
        words, of_slot = self.name.split("-"), self.slot.split("-")
        while len(words) > 1 and words[-1] in of_slot:
            words.pop()
        return "".join(word.capitalize() for word in [*words, *of_slot])

    @property
    def hook(self) -> str:
        """The name of the template of the package's hook."""
        return "hook_command.py" if self.slot == COMMAND else "hook.py"

    @property
    def module(self) -> str:
        """The name of the component's module and templates, such as touch_source."""
        return self.slot.replace("-", "_")

    @property
    def usage(self) -> str:
        """The command that uses the component."""
        kind = registry().kinds[self.slot]
        return kind.usage.format(name=self.name) if kind else f"tactile-loc run --{self.slot} {self.name}"

    @property
    def requires(self) -> str:
        """The distribution that the package depends on: tactile-loc, or the one that defines the kind."""
        kind = registry().kinds[self.slot]
        package = kind.templates.partition(".")[0] if kind else "tactile_loc"
        return "tactile-loc" if package == "tactile_loc_cli" else package.replace("_", "-")

    def require_free(self) -> None:
        """Raise PluginConflictError if a component of the slot or an installed package already has this name."""
        for found in registry().offers:
            if (found.spec.slot, found.spec.name) == (self.slot, self.name):
                raise PluginConflictError(
                    f"{found.distribution} already has a {self.slot} {self.name!r}; choose another name"
                )
        if find_spec(self.package) is not None:
            raise PluginConflictError(
                f"a package {self.package} is already installed; choose another name than {self.name!r}"
            )


def describe_example(slot: str) -> str:
    """Return the summary of the component in a slot's template."""
    kind = registry().kinds[slot]
    return kind.example if kind else SUMMARIES[slot]


def render(naming: Naming) -> dict[str, str]:
    """Return the text of each file of the package. The keys are the files' paths in the package's folder."""
    named = ("slot", "name", "distribution", "package", "class_name", "module", "usage", "requires")
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
