"""The version of the plugin interface, and the refusal of components written for another version.

| version | what changed |
|---|---|
| 2 | `Matcher.scores` takes `weights`; `Capabilities.weights`; `Fuser.fuse` may return `NoPoseLeft` |
| 1 | the first version |
"""

import inspect
from typing import Any

INTERFACE_VERSION = 2
WEIGHTS_CHANGE = "give scores a second argument, weights"


def explain_version(version: int, distribution: str) -> str:
    """Return why a component of a distribution, written for interface `version`, is refused, and what to do.

    The text is empty if the component has the current version.
    """
    if version > INTERFACE_VERSION:
        advice = "pip install --upgrade tactile-loc"
        return f"needs plugin interface {version}, but this tactile-loc has {INTERFACE_VERSION}: {advice}"
    if version < INTERFACE_VERSION:
        advice = f"update {distribution}"
        return f"was written for plugin interface {version}, but this tactile-loc has {INTERFACE_VERSION}: {advice}"
    return ""


def takes_weights(matcher: Any) -> bool:
    """Return whether the `scores` method of a matcher (class or instance) takes a second argument."""
    taken = [p for p in inspect.signature(matcher.scores).parameters.values() if p.kind is not p.KEYWORD_ONLY]
    several = any(p.kind is p.VAR_POSITIONAL for p in taken)
    return several or len(taken) > 1 + isinstance(matcher, type)


def require_interface(kind: Any, slot: str) -> None:
    """Raise TypeError if a component's class does not follow the interface of its slot."""
    if slot == "matcher" and kind.capabilities.weights and not takes_weights(kind):
        raise TypeError(f"{kind.__name__}.scores takes no weights; {WEIGHTS_CHANGE}, or declare weights=False")
