"""The version of the plugin interface, and the adaptation of components written for an earlier version.

| version | what changed |
|---|---|
| 2 | `Matcher.scores` takes `weights` (before: `Matcher.weighted_scores`); `Capabilities.weights` |
| 1 | the first version |
"""

from __future__ import annotations

import inspect
import logging
from dataclasses import replace
from typing import Any

logger = logging.getLogger(__name__)

INTERFACE_VERSION = 2
WEIGHTS_CHANGE = "give scores a second argument, weights"


def takes_weights(matcher: Any) -> bool:
    """Return whether the `scores` method of a matcher (class or instance) takes a second argument."""
    taken = [p for p in inspect.signature(matcher.scores).parameters.values() if p.kind is not p.KEYWORD_ONLY]
    several = any(p.kind is p.VAR_POSITIONAL for p in taken)
    return several or len(taken) > 1 + isinstance(matcher, type)


def require_interface(kind: Any, slot: str, version: int) -> None:
    """Raise TypeError if a component's class does not follow interface `version` of its slot."""
    if version >= 2 and slot == "matcher" and kind.capabilities.weights and not takes_weights(kind):
        raise TypeError(f"{kind.__name__}.scores takes no weights; {WEIGHTS_CHANGE}, or declare weights=False")


def adapt(kind: Any, slot: str, version: int) -> Any:
    """Return a component's class, written for interface `version`, adapted to the current version.

    A matcher of version 1 gets a method `scores(queries, weights)`, which calls the matcher's `weighted_scores`. If the
    matcher has no `weighted_scores`, it is declared with weights=False, so it compares with listed poses only.
    """
    if version >= 2 or slot != "matcher" or takes_weights(kind):
        return kind
    weighs = hasattr(kind, "weighted_scores")  # only interface 1 had this method
    consequence = "its weighted_scores is used" if weighs else "it compares with listed poses only"
    logger.warning(
        "the matcher %s was written for plugin interface 1, so %s; to update it to interface %d, %s",
        kind.__name__, consequence, INTERFACE_VERSION, WEIGHTS_CHANGE,
    )  # fmt: skip

    def scores(self: Any, queries: Any, weights: Any = None) -> Any:
        """Return scores (M, N) as `Matcher.scores` does."""
        return kind.scores(self, queries) if weights is None else kind.weighted_scores(self, queries, weights)

    members = {
        "scores": scores, "outdated": WEIGHTS_CHANGE, "capabilities": replace(kind.capabilities, weights=weighs),
        **{name: getattr(kind, name) for name in ("__module__", "__qualname__", "__doc__")},
    }  # fmt: skip
    return type(kind)(kind.__name__, (kind,), members)
