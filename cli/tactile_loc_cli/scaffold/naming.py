"""Names that follow from a new component's slot and name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.util import find_spec

from tactile_loc.core.runtime.errors import ConfigError, PluginConflictError
from tactile_loc.slots.registry import COMMAND, registry
from tactile_loc_cli.options import require_slot

KEBAB = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
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
        if not KEBAB.fullmatch(self.name) or len(self.name) > LONGEST:
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
