"""Matchers of third-party plugins, for the current, an earlier and a later plugin interface."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from tactile_loc.slots import registry as module
from tactile_loc.slots.component import Capabilities
from tactile_loc.slots.matcher import Matcher
from tactile_loc.slots.registry import ComponentSpec, hookimpl, registry


class Plain(Matcher):
    """A matcher of interface 1 without weights."""

    def index(self, bank):
        self.bank = np.array(bank, np.float32)

    def scores(self, queries):
        return np.float32(-0.5) * ((queries[:, None] - self.bank) ** 2).sum(axis=-1)


class Weighing(Plain):
    """A matcher of interface 1 with weights."""

    def weighted_scores(self, queries, weights):
        if (weights == 1).all():
            return self.scores(queries)
        return np.stack([(-0.5 * w * (q - self.bank) ** 2).sum(axis=1) for q, w in zip(queries, weights, strict=True)])


class Listed(Plain):
    """A matcher of interface 2 that declares no support for weights."""

    capabilities = Capabilities(weights=False)


SPECS = {
    "plain": ComponentSpec("matcher", "plain", "strange_matchers:Plain", "of interface 1"),
    "weighing": ComponentSpec("matcher", "weighing", "strange_matchers:Weighing", "of interface 1, weighs"),
    "listed": ComponentSpec("matcher", "listed", "strange_matchers:Listed", "cannot weigh", interface=2),
    "forgetful": ComponentSpec("matcher", "forgetful", "strange_matchers:Plain", "claims interface 2", interface=2),
    "ahead": ComponentSpec("matcher", "ahead", "strange_matchers:Plain", "of a later interface", interface=99),
}


class Stranger:
    """The entry point of a plugin that offers all these matchers."""

    name = value = "strange"
    dist = SimpleNamespace(name="strange-matchers")

    def load(self) -> Any:
        return SimpleNamespace(tactile_loc_components=hookimpl(lambda: list(SPECS.values())))


@contextmanager
def installed() -> Iterator[None]:
    """Install all these matchers beside the built-in components."""
    found = [point for point in module.entry_points(group=module.PROJECT) if module._is_built_in(point)]
    with patch.object(module, "entry_points", lambda group: [*found, Stranger()]):
        registry.cache_clear()
        yield
    registry.cache_clear()
