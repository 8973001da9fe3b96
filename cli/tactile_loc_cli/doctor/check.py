"""One thing that was looked at, and how it is looked at without bringing the program down."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from tactile_loc.core.errors import TactileLocError

NOTHING: Mapping[str, Any] = MappingProxyType({})


class State(StrEnum):
    """How something is."""

    OK = "ok"
    MISSING = "missing"
    BROKEN = "broken"


@dataclass(frozen=True)
class Check:
    """What was found: `says` what it means, `remedy` what to do; `facts` are JSON values, in SI units."""

    name: str
    state: State
    says: str
    remedy: str = ""
    required: bool = False
    facts: Mapping[str, Any] = field(default_factory=lambda: NOTHING)

    @property
    def is_fatal(self) -> bool:
        """Whether tactile-loc cannot be expected to work."""
        return self.required and self.state is not State.OK

    def record(self) -> dict[str, Any]:
        """Return it as JSON values."""
        said = {"says": self.says, "remedy": self.remedy, "required": self.required}
        return {"name": self.name, "state": str(self.state), **said, **self.facts}


@dataclass(frozen=True)
class Probe:
    """Looks at something; `look` may raise whatever it likes."""

    name: str
    look: Callable[[], Sequence[Check]]
    required: bool = False

    def checks(self) -> list[Check]:
        """Return what was found; a failure to look is itself a finding."""
        try:
            return list(self.look())
        except TactileLocError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 - whatever is broken here, the other probes must still be run
            reason = f"{type(error).__name__}: {error}"
        return [Check(self.name, State.BROKEN, reason, required=self.required)]
