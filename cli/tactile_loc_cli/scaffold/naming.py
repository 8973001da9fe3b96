"""Everything that follows from a new component's slot and name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.util import find_spec

from tactile_loc.core.errors import ConfigError, PluginConflictError, UnknownPluginError, did_you_mean
from tactile_loc.core.slots.registry import SLOTS

KEBAB = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST = 30  # so that the lines it is written into stay short


@dataclass(frozen=True)
class Naming:
    """A new component: its slot, and its name in kebab case. Raises UnknownPluginError or ConfigError for others."""

    slot: str
    name: str

    def __post_init__(self) -> None:
        if self.slot not in SLOTS:
            raise UnknownPluginError(
                f"there is no slot {self.slot!r}.{did_you_mean(self.slot, SLOTS)} The slots are {', '.join(SLOTS)}"
            )
        if not KEBAB.fullmatch(self.name) or len(self.name) > LONGEST:
            raise ConfigError(
                f"a component cannot be called {self.name!r}; use lower-case letters and digits, words joined by "
                f"hyphens, as my-{self.slot}, at most {LONGEST} characters"
            )

    @property
    def distribution(self) -> str:
        """What is installed, and the folder it lies in: tactile-loc-my-refiner."""
        return f"tactile-loc-{self.name}"

    @property
    def package(self) -> str:
        """What is imported: tactile_loc_my_refiner."""
        return self.distribution.replace("-", "_")

    @property
    def class_name(self) -> str:
        """The component's class: MyRefiner of my-refiner, SplineRefiner of spline."""
        words = self.name.split("-")
        if len(words) > 1 and words[-1] == self.slot:
            words.pop()
        return "".join(word.capitalize() for word in [*words, self.slot])

    def require_free(self) -> None:
        """Raise PluginConflictError when the slot has a component of this name, or the package's name is taken."""
        from tactile_loc.core.slots.registry import registry

        for found in registry().components:
            if (found.spec.slot, found.spec.name) == (self.slot, self.name):
                raise PluginConflictError(
                    f"there is a {self.slot} {self.name!r} already, of {found.distribution}; choose another name"
                )
        if find_spec(self.package) is not None:
            raise PluginConflictError(
                f"a package {self.package} is installed already; choose another name than {self.name!r}"
            )
